(() => {
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
  for (const heading of document.querySelectorAll("table.sortable th")) {
    heading.querySelector("button").addEventListener("click", () => sortBy(heading));
  }

  const save = document.getElementById("save");
  if (save) {
    save.addEventListener("click", () => {
      const text = JSON.stringify(parsed("calibration"), null, 2) + "\n";
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
      link.download = "calibration.json";
      link.click();
    });
  }

  // Figures: the page is read before the library runs. What is in view or near it is drawn first; the
  // other flat ones follow while the browser has nothing else to do, and those in space wait for a reader.
  const figures = parsed("figures") || {};
  const NARROW = 500;
  const settings = { displayModeBar: false, responsive: true };
  const started = new Set();
  const NEAR = "400px";

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
  const draw = async (place) => {
    const name = place.dataset.figure;
    if (started.has(name) || !figures[name]) return;
    started.add(name);
    const space = place.closest(".space");
    if (space && !webgl()) {
      place.dataset.drawn = "still"; // the still picture stays
      return;
    }
    const Plotly = await plotly();
    if (!Plotly) return;
    try {
      if (space) space.classList.add("live");
      if (space && place.clientWidth < NARROW) shrink(place, figures[name].layout);
      await Plotly.newPlot(place, figures[name].data, figures[name].layout, settings);
      if (!space) {
        scalable(place);
        place.on("plotly_relayout", () => scalable(place));
      }
      place.dataset.drawn = "yes";
    } catch (error) {
      if (!space) throw error;
      space.classList.remove("live");
      place.dataset.drawn = "still";
    }
  };
  const seen = () => new Promise((resolve) => {
    const drawing = (entries) => {
      const near = entries.filter((one) => one.isIntersecting);
      return Promise.all(near.map((one) => draw(one.target.querySelector(".canvas"))));
    };
    const observer = new IntersectionObserver(
      (entries) => drawing(entries).then(resolve), // the first time of all figures
      { rootMargin: NEAR },
    );
    const places = document.querySelectorAll(".plot, .space");
    for (const place of places) observer.observe(place);
    if (!places.length) resolve();
  });
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
      await seen();
      performance.mark("view-drawn"); // all that a reader sees first
      for (const place of document.querySelectorAll(".plots .canvas")) {
        await new Promise((resolve) => setTimeout(resolve));
        await draw(place);
      }
    } finally {
      release();
    }
    document.documentElement.dataset.ready = "yes";
  };

  for (const button of document.querySelectorAll(".switch button")) {
    button.addEventListener("click", () => {
      for (const other of document.querySelectorAll(".switch button")) {
        other.setAttribute("aria-pressed", String(other === button));
      }
      for (const space of document.querySelectorAll(".space")) {
        const mine = space.dataset.space === button.dataset.show;
        space.classList.toggle("shown", mine);
        space.classList.toggle("hidden", !mine);
      }
    });
  }
  start();
})();
