// The library is packed, which keeps the page small. Figures are drawn once it is unpacked.
const drawn = (async () => {
  const library = document.getElementById("library");
  if (!library) return;
  const packed = Uint8Array.from(atob(library.textContent), letter => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.text = await new Response(stream).text();
  document.head.append(script);
  for (const plot of document.querySelectorAll(".plot")) {
    const {data, layout, config} = JSON.parse(plot.querySelector("script").textContent);
    await Plotly.newPlot(plot.querySelector("div"), data, layout, config);
  }
})();

// Saves a table as CSV, a figure as PNG or SVG, on a white ground; nothing is fetched.
document.addEventListener("click", async event => {
  const kind = event.target.dataset && event.target.dataset.save;
  if (!kind) return;
  const figure = event.target.closest("figure");
  const plot = figure.querySelector(".js-plotly-plot"), image = figure.querySelector("img");
  const title = figure.querySelector("h3, figcaption").textContent;
  const link = document.createElement("a");
  link.download = `${title.toLowerCase().replace(/[^a-z0-9]+/g, "-").slice(0, 60)}.${kind}`;
  if (kind === "csv") {
    link.href = URL.createObjectURL(new Blob(["\ufeff", asCsv(figure.querySelector("table"))]));
  } else if (plot) {
    const layout = Object.assign({}, plot.layout, {paper_bgcolor: "white", plot_bgcolor: "white"});
    const size = {width: plot.offsetWidth, height: plot.offsetHeight, scale: kind === "png" ? 2 : 1};
    link.href = await Plotly.toImage({data: plot.data, layout}, {format: kind, ...size});
  } else {
    link.href = kind === "png" ? asPng(image) : image.src;
  }
  link.click();
});

// Before text that a spreadsheet would run is an apostrophe, as files/output.py has it.
function asCsv(table) {
  const cell = text => /[",\r\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text;
  const runs = /^[\s\x00-\x20\x7f\u200b'"]*([=+@\uff1d\uff0b\uff0d\uff20-].*)$/s;
  const safe = text => (runs.test(text) && isNaN(runs.exec(text)[1]) ? `'${text}` : text);
  const plain = text => text.split(";").map(safe).join(";");
  return [...table.rows].map(row => [...row.cells].map(each => cell(plain(each.innerText.trim())))
    .join(",")).join("\n") + "\n";
}

function asPng(image) {
  const canvas = document.createElement("canvas");
  canvas.width = 2 * image.naturalWidth;
  canvas.height = 2 * image.naturalHeight;
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  return canvas.toDataURL("image/png");
}
