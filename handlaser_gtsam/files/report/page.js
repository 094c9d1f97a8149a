// The page: sortable tables, figures, and what a server may renew of them.
const page = (() => {
  const parsed = (id) => {
    const element = document.getElementById(id);
    return element ? JSON.parse(element.textContent) : null;
  };

  // Tables sort by a click on a title: by the number behind a cell, or by its text.
  const collator = new Intl.Collator("en", { numeric: true });
  const sortBy = (heading) => {
    const table = heading.closest("table");
    const column = [...heading.parentNode.children].indexOf(heading);
    const down = heading.getAttribute("aria-sort") === "ascending";
    for (const other of heading.parentNode.children) other.setAttribute("aria-sort", "none");
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    const body = table.tBodies[0];
    const rows = [...body.rows].map((row, place) => {
      const cell = row.cells[column];
      const value = cell.dataset.v === undefined ? null : Number(cell.dataset.v);
      return { row, place, value, text: cell.textContent };
    });
    const numeric = rows.some((one) => one.value !== null);
    rows.sort((a, b) => {
      if (numeric && (a.value === null || b.value === null)) {
        return (a.value === null) - (b.value === null) || a.place - b.place; // no number: last
      }
      const order = numeric ? a.value - b.value : collator.compare(a.text, b.text);
      return (down ? -order : order) || a.place - b.place;
    });
    body.append(...rows.map((one) => one.row));
  };

  const saveResult = () => {
    const text = JSON.stringify(parsed("calibration"), null, 2) + "\n";
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = "calibration.json";
    link.click();
  };

  // Of the two views in space one is shown.
  let frame = "space-world";
  const showFrame = () => {
    const buttons = [...document.querySelectorAll(".switch button")];
    if (!buttons.some((one) => one.dataset.show === frame)) return;
    for (const one of buttons) one.setAttribute("aria-pressed", String(one.dataset.show === frame));
    for (const space of document.querySelectorAll(".space")) {
      const mine = space.dataset.space === frame;
      space.classList.toggle("shown", mine);
      space.classList.toggle("hidden", !mine);
    }
  };

  document.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (!button) return;
    if (button.closest("table.sortable th")) sortBy(button.closest("th"));
    if (button.id === "save") saveResult();
    if (button.dataset.show) {
      frame = button.dataset.show;
      showFrame();
    }
  });

  // Figures: the page is read before the library runs. What is in view or near it is drawn first; the
  // other flat ones follow while the browser has nothing else to do, and those in space wait for a reader.
  const figures = parsed("figures") || {};
  const NARROW = 500;
  const NEAR = "400px";
  const settings = { displayModeBar: false, responsive: true };
  const pending = new Set(Object.keys(figures));
  const near = new Set();
  const placeOf = (name) => document.querySelector(`.canvas[data-figure="${name}"]`);
  const inSpace = (name) => placeOf(name).closest(".space") !== null;

  // A drawing keeps its proportions on paper, where it is narrower than on the screen.
  const scalable = (place) => {
    for (const drawing of place.querySelectorAll("svg.main-svg")) {
      const { width, height } = drawing.getBoundingClientRect();
      if (!width) continue;
      drawing.setAttribute("viewBox", `0 0 ${width} ${height}`);
      place.style.setProperty("--ratio", `${width} / ${height}`);
    }
  };
  const webgl = () => document.createElement("canvas").getContext("webgl") !== null;
  const shrink = (place, layout) => {
    const eye = layout.scene.camera.eye;
    for (const axis of Object.keys(eye)) eye[axis] *= 1.4;
    layout.height = 400;
    place.style.height = "400px";
  };
  const draw = async (name) => {
    const place = placeOf(name);
    const space = place.closest(".space");
    const first = place.dataset.drawn === undefined;
    if (first && space && !webgl()) place.dataset.drawn = "still"; // the still picture stays
    if (place.dataset.drawn === "still") return;
    const Plotly = await plotly();
    if (!Plotly) return;
    const { data, layout } = figures[name];
    layout.uirevision = "kept"; // who has turned or zoomed the view keeps it
    try {
      if (space) space.classList.add("live");
      if (space && place.clientWidth < NARROW) shrink(place, layout);
      await Plotly.react(place, data, layout, settings);
      if (!space) scalable(place);
      if (!space && first) place.on("plotly_relayout", () => scalable(place));
      place.dataset.drawn = "yes";
    } catch (error) {
      if (!space) throw error;
      space.classList.remove("live");
      place.dataset.drawn = "still";
    }
  };

  const next = (wanted) => [...pending].find((name) => placeOf(name) && wanted(name));
  const paused = () => document.documentElement.dataset.page !== undefined && document.hidden;
  let drawing = null;
  const drawAll = async () => {
    let name = null;
    while (!paused()) {
      name = next((one) => near.has(one));
      if (name === undefined) {
        if (!performance.getEntriesByName("view-drawn").length) {
          performance.mark("view-drawn"); // all that a reader sees first
        }
        name = next((one) => !inSpace(one));
        if (name === undefined) return;
        await new Promise((resolve) => setTimeout(resolve));
      }
      if (!placeOf(name)) continue; // its section came anew meanwhile
      pending.delete(name);
      await draw(name);
    }
  };
  const drawPending = () => {
    drawing = drawing || drawAll().finally(() => { drawing = null; });
    return drawing;
  };

  const looked = {};
  const observed = new Promise((resolve) => { looked.once = resolve; });
  const observer = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const canvas = entry.target.querySelector(".canvas");
      if (!canvas) continue;
      near[entry.isIntersecting ? "add" : "delete"](canvas.dataset.figure);
    }
    looked.once();
    if (document.documentElement.dataset.ready) drawPending();
  }, { rootMargin: NEAR });
  const observe = (root) => {
    const places = root.querySelectorAll(".plot");
    for (const place of places) observer.observe(place);
    if (!places.length) looked.once();
  };

  // A browser that prints without a reader does so with the load event, which waits for images: while
  // figures are missing each image that has loaded asks for another one.
  const holdLoad = () => {
    let number = 0;
    let held = true;
    const ask = () => {
      if (!held) return;
      const image = new Image();
      image.onload = image.onerror = ask;
      number += 1;
      image.src = `data:image/svg+xml,<svg xmlns='http://www.w3.org/2000/svg' id='n${number}'/>`;
    };
    ask();
    return () => { held = false; };
  };
  const start = async () => {
    if (!window.DecompressionStream) return;
    document.documentElement.classList.add("drawing");
    const release = holdLoad();
    try {
      observe(document);
      await observed;
      await drawPending();
    } finally {
      release();
    }
    document.documentElement.dataset.ready = "yes";
  };
  start();

  // A section that a server renews keeps its drawings: a view in space, too, that a reader has turned.
  const renewSection = (name, html) => {
    const section = document.getElementById(name);
    const fresh = document.createElement("template");
    fresh.innerHTML = html;
    for (const place of fresh.content.querySelectorAll(".canvas[data-figure]")) {
      const drawn = section.querySelector(`.canvas[data-figure="${place.dataset.figure}"]`);
      if (!drawn || drawn.dataset.drawn !== "yes") continue;
      const space = place.closest(".space");
      if (space) space.classList.add("live");
      place.replaceWith(drawn);
    }
    for (const one of section.querySelectorAll(".plot")) observer.unobserve(one);
    section.replaceChildren(fresh.content);
    showFrame();
    observe(section);
  };
  const renewFigure = (name, figure) => {
    figures[name] = figure;
    pending.add(name);
  };
  const renewResult = (result) => {
    document.getElementById("calibration").textContent = JSON.stringify(result);
  };
  return { renewSection, renewFigure, renewResult, drawPending };
})();
