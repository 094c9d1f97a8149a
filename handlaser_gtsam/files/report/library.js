"use strict";
// plotly.js stands compressed in the page; it is unpacked once, when there is something to draw.
// Comes to undefined in an old browser, which has tables and still pictures.
const plotly = (() => {
  let found = null;
  const unpacked = async () => {
    const library = document.getElementById("plotly");
    if (!library || !window.DecompressionStream) return undefined;
    const bytes = Uint8Array.from(atob(library.textContent), (letter) => letter.charCodeAt(0));
    const code = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const script = document.createElement("script");
    script.textContent = await new Response(code).text();
    document.head.append(script);
    library.remove();
    return window.Plotly;
  };
  return () => {
    found = found || unpacked();
    return found;
  };
})();
