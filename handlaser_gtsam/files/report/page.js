"use strict";
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

  // Figures: the flat ones at once, one a frame of the screen; those in space last, and where they show.
  const figures = parsed("figures") || {};
  const settings = { displayModeBar: false, responsive: true };
  const drawn = new Set();
  const draw = async (place) => {
    const name = place.dataset.figure;
    if (drawn.has(name) || !figures[name] || !window.Plotly) return;
    drawn.add(name);
    const space = place.closest(".space");
    try {
      if (space) space.classList.add("live");
      await window.Plotly.newPlot(place, figures[name].data, figures[name].layout, settings);
      if (space && !place.querySelector("canvas")) throw new Error("no WebGL");
      place.dataset.drawn = "yes";
    } catch (error) {
      if (!space) throw error;
      space.classList.remove("live"); // the still picture stays
      place.dataset.drawn = "still";
    }
  };
  const pause = () => new Promise((resolve) => setTimeout(resolve));
  const all = async () => {
    for (const place of document.querySelectorAll(".plots .canvas")) {
      await draw(place);
      await pause();
    }
    const first = document.querySelector(".space:not(.later) .canvas");
    if (first) await draw(first);
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
        if (mine) draw(space.querySelector(".canvas"));
      }
    });
  }

  // On paper two figures stand side by side: they take the width that they have there.
  const fit = () => {
    for (const place of document.querySelectorAll(".plots .canvas[data-drawn]")) {
      window.Plotly.Plots.resize(place);
    }
  };
  if (window.Plotly) {
    window.matchMedia("print").addEventListener("change", fit);
    window.addEventListener("beforeprint", fit);
    window.addEventListener("afterprint", fit);
    all();
  }
})();
