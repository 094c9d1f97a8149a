// The live page: what a server says of a recording that grows.
(() => {
  const QUIET = 35000; // milliseconds without a beat of the server, after which the connection is dead
  const LONGEST_WAIT = 10000;
  const at = (id) => document.getElementById(id);
  const root = document.documentElement;
  const show = (element, wanted) => {
    element.hidden = !wanted;
  };
  const draw = async () => {
    const state = root.dataset.state;
    await page.drawPending();
    root.dataset.drawn = state;
  };
  document.addEventListener("visibilitychange", draw);

  let file = "";
  let opening = "";
  const title = () => {
    document.title = [opening, file, "handlaser watch"].filter(Boolean).join(" · ");
  };
  const heard = {
    section: (event) => {
      const { name, html } = JSON.parse(event.data);
      page.renewSection(name, html);
    },
    figure: (event) => {
      const { name, figure } = JSON.parse(event.data);
      page.renewFigure(name, figure);
    },
    result: (event) => page.renewResult(JSON.parse(event.data)),
    state: (event) => {
      show(at("content"), true);
      opening = JSON.parse(event.data).opening;
      root.dataset.state = event.lastEventId;
      draw();
      title();
    },
    status: (event) => {
      const status = JSON.parse(event.data);
      file = status.file;
      at("file").textContent = file;
      const changed = status.changed_ms === null ? "" : new Date(status.changed_ms).toLocaleTimeString();
      at("changed").textContent = changed && `changed ${changed}`;
      at("phase").textContent = status.words;
      at("error").textContent = status.error;
      show(at("error"), status.error);
      at("note").textContent = status.note;
      show(at("note"), status.note);
      document.querySelector("main").classList.toggle("stale", Boolean(status.error) || status.phase === "waiting");
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
