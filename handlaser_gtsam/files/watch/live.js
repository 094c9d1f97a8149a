{% include "library.js" %}
(() => {
  const QUIET = 35000; // milliseconds without a beat of the server, after which the connection is dead
  const LONGEST_WAIT = 10000;
  const settings = { displayModeBar: false, responsive: true };
  const at = (id) => document.getElementById(id);
  const root = document.documentElement;

  // Words are set as text, never as HTML.
  const made = (tag, words = "", kind = "") => {
    const element = document.createElement(tag);
    if (kind) element.className = kind;
    element.textContent = words;
    return element;
  };
  const fill = (element, ...children) => element.replaceChildren(...children);
  const show = (element, wanted) => {
    element.hidden = !wanted;
  };

  const table = (place, content) => {
    show(place, content);
    if (!content) return fill(place);
    const kinds = content.columns.map((one) => `${one.number ? "n" : "t"}${one.wide ? " wide" : ""}`);
    const head = made("tr");
    content.columns.forEach((one, i) => head.append(made("th", one.title, kinds[i])));
    const body = made("tbody");
    for (const row of content.rows) {
      const line = made("tr");
      row.forEach(([words, mark], i) => line.append(made("td", words, `${kinds[i]} ${mark}`.trim())));
      body.append(line);
    }
    const top = made("thead");
    top.append(head);
    const whole = made("table");
    whole.append(top, body);
    const scroll = made("div", "", "scroll");
    scroll.append(whole);
    const parts = content.caption ? [made("figcaption", content.caption)] : [];
    if (content.note) return fill(place, ...parts, scroll, made("p", content.note, "note"));
    return fill(place, ...parts, scroll);
  };

  const words = (state) => {
    at("verdict").className = `verdict ${state.verdict.mark}`;
    at("opening").textContent = state.verdict.opening;
    fill(at("findings"), ...state.verdict.findings.map((one) => made("li", one)));
    const counts = state.counts.map(([term, number]) => {
      const pair = made("div");
      pair.append(made("dt", term), made("dd", number));
      return pair;
    });
    fill(at("counts"), ...counts);
    table(at("beams"), state.beams);
    show(at("warnings-section"), state.warnings.length);
    fill(at("warnings"), ...state.warnings.map((one) => made("li", one)));
    at("promise").textContent = state.next.promise;
    show(at("promise"), state.next.promise);
    fill(at("advice"), ...state.next.advice.map((one) => made("p", one)));
    table(at("next-stations"), state.next.stations);
    show(at("content"), true);
  };

  const figure = async (Plotly, name, content) => {
    const place = at(name);
    show(at(`${name}-figure`), content);
    if (!content) return;
    const { data, layout, caption } = content;
    at(`${name}-figure`).querySelector("figcaption").textContent = caption;
    layout.height = place.clientHeight;
    layout.uirevision = "kept"; // who has turned the view keeps it
    if (layout.scene && place.clientWidth < 500) {
      for (const axis of Object.keys(layout.scene.camera.eye)) layout.scene.camera.eye[axis] *= 1.4;
      Object.assign(layout.legend, { orientation: "h", yanchor: "bottom" });
      layout.margin.t = 30;
    }
    try {
      await Plotly.react(place, data, layout, settings);
      place.dataset.drawn = "yes";
    } catch (error) {
      fill(place, made("p", `This browser cannot draw it (${error.message}).`, "soft"));
      place.dataset.drawn = "no";
    }
  };
  const figures = async (state) => {
    show(at("no-falling"), !state.falling);
    const Plotly = await plotly();
    if (!Plotly) return; // words and tables are all there is
    await figure(Plotly, "falling", state.falling);
    await figure(Plotly, "space", state.space);
  };

  // Whatever comes while one state is drawn, the newest is drawn next.
  let newest = null;
  let drawing = false;
  const draw = async () => {
    if (drawing) return;
    drawing = true;
    while (newest && !document.hidden) {
      const { id, state } = newest;
      newest = null;
      await figures(state);
      root.dataset.drawn = id;
    }
    drawing = false;
  };
  document.addEventListener("visibilitychange", draw);

  let file = "";
  const title = () => {
    const opening = at("opening").textContent;
    document.title = [opening, file, "handlaser watch"].filter(Boolean).join(" · ");
  };
  const heard = {
    state: (event) => {
      const state = JSON.parse(event.data);
      words(state);
      root.dataset.state = event.lastEventId;
      newest = { id: event.lastEventId, state };
      draw();
      title();
    },
    status: (event) => {
      const status = JSON.parse(event.data);
      file = status.file;
      at("file").textContent = file;
      const changed = status.changed_ms === null ? "" : new Date(status.changed_ms).toLocaleTimeString();
      at("changed").textContent = changed && `changed ${changed}`;
      at("phase").textContent = status.phase === "waiting" ? "waiting" : status.words;
      at("error").textContent = status.error;
      show(at("error"), status.error);
      at("note").textContent = status.note;
      show(at("note"), status.note);
      document.querySelector("main").classList.toggle("stale", Boolean(status.error));
      root.dataset.phase = status.phase;
      title();
    },
    hello: (event) => {
      if (event.data !== root.dataset.page) window.location.reload(); // a server of another version
    },
    beat: () => {},
  };

  // The browser reconnects by itself; where it gives up, this does not.
  let source = null;
  let wait = 500;
  let last = 0;
  const connection = (now, said) => {
    at("connection").dataset.now = now;
    at("connection").textContent = said;
  };
  const connect = () => {
    last = Date.now();
    source = new EventSource("events");
    source.addEventListener("open", () => {
      wait = 500;
      connection("live", "live");
    });
    source.addEventListener("error", () => {
      connection("lost", "connection lost, trying again");
      if (source.readyState !== EventSource.CLOSED) return;
      wait = Math.min(2 * wait, LONGEST_WAIT);
      setTimeout(connect, wait);
    });
    for (const [kind, take] of Object.entries(heard)) {
      source.addEventListener(kind, (event) => {
        last = Date.now();
        take(event);
      });
    }
  };
  setInterval(() => {
    if (source.readyState !== EventSource.OPEN || Date.now() - last < QUIET) return;
    source.close();
    connection("lost", "connection lost, trying again");
    connect();
  }, 5000);
  connect();
})();
