// Draws the charts of the page. The data of each chart are JSON in the script element beside it.
"use strict";
(() => {
  const palette = JSON.parse(document.getElementById("colours").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");

  // Numbers of 8 bytes, little-endian, as base64.
  function numbers(text) {
    const raw = atob(text);
    const bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return new Float64Array(bytes.buffer);
  }

  // Names may contain characters that plotly would read as markup.
  const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;");

  // Ticks of a logarithmic axis: plotly would write 1 and 10 beside powers of ten.
  const powers = { exponentformat: "power", labelalias: { 1: "10<sup>0</sup>", 10: "10<sup>1</sup>" } };

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const of = (name) => style.getPropertyValue(name).trim();
    return { text: of("--text"), line: of("--line"), page: of("--page"), soft: of("--soft"), lines: dark.matches ? palette.dark : palette.light };
  }

  function themed(panel) {
    const c = colours();
    const axis = { gridcolor: c.line, zerolinecolor: c.line, linecolor: c.line };
    return {
      layout: Object.fromEntries([
        ["font.color", c.text], ["paper_bgcolor", c.page], ["plot_bgcolor", c.page], ["hoverlabel.bgcolor", c.soft], ["hoverlabel.font.color", c.text],
        ...Object.entries(axis).flatMap(([key, value]) => [[`xaxis.${key}`, value], [`yaxis.${key}`, value]]),
      ]),
      lines: panel.lines.map((line) => c.lines[line.colour]),
    };
  }

  function draw(place, panel, x) {
    const c = colours();
    const last = place.classList.contains("last");
    const traces = panel.lines.map((line) => ({
      type: "scatter", mode: line.x.length > 16 ? "lines" : "lines+markers", name: plain(line.label), x: numbers(line.x), y: numbers(line.y),
      line: { color: c.lines[line.colour], width: 1.3, dash: line.dashed ? "dash" : "solid" }, connectgaps: false, showlegend: line.label !== "",
      hovertemplate: "%{y:.6g}",
    }));
    const layout = {
      margin: { l: 64, r: 12, t: 30, b: last ? 44 : 26 }, font: { size: 12, family: "system-ui, sans-serif" }, hovermode: "x", dragmode: "zoom",
      showlegend: panel.lines.some((line) => line.label !== ""),
      legend: { orientation: "h", x: 0, y: 1.02, xanchor: "left", yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" },
      xaxis: { title: { text: last ? plain(x.title) : "", standoff: 6 }, type: x.log ? "log" : "linear", hoverformat: ".6g", autorangeoptions: { include: x.range }, ...(x.log ? { ...powers, dtick: 1 } : {}) },
      yaxis: { title: { text: plain(panel.title), standoff: 4 }, type: panel.log ? "log" : "linear", automargin: false, ...(panel.log ? powers : {}),
        ...(panel.limit === null ? {} : { range: [-panel.limit, panel.limit] }) },
    };
    const theme = themed(panel);
    for (const [path, value] of Object.entries(theme.layout)) {
      const keys = path.split(".");
      const key = keys.pop();
      keys.reduce((node, name) => (node[name] ??= {}), layout)[key] = value;
    }
    // Only these buttons, because some of plotly's other buttons send data away.
    const buttons = [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "autoScale2d"]];
    const options = { responsive: true, displaylogo: false, modeBarButtons: buttons, plotlyServerURL: "" };
    return Plotly.newPlot(place, traces, layout, options);
  }

  function remark(parent, text) {
    if (!text) return;
    const note = document.createElement("p");
    note.className = "plotnote";
    note.textContent = text;
    parent.append(note);
  }

  // The panels of a chart show the same range of x.
  function together(places) {
    let busy = false;
    for (const place of places) {
      place.on("plotly_relayout", (event) => {
        const all = event["xaxis.autorange"] === true;
        const range = event["xaxis.range"] ?? [event["xaxis.range[0]"], event["xaxis.range[1]"]];
        if (busy || !(all || range[0] !== undefined)) return;
        busy = true;
        const change = all ? { "xaxis.autorange": true } : { "xaxis.range": [...range] };
        Promise.all(places.filter((other) => other !== place).map((other) => Plotly.relayout(other, change))).finally(() => { busy = false; });
      });
    }
  }

  const drawn = [];
  const charts = [...document.querySelectorAll("figure.chart")].map((figure) => {
    const data = JSON.parse(figure.querySelector("script.data").textContent);
    const parent = figure.querySelector(".plots");
    // All places are made before the first panel is drawn, because a panel keeps the size that its place has then.
    const places = data.panels.map((panel, i) => {
      const place = document.createElement("div");
      place.className = i === data.panels.length - 1 ? "panel last" : "panel";
      remark(parent, panel.note);
      parent.append(place);
      drawn.push([place, panel]);
      return place;
    });
    remark(parent, data.note);
    return Promise.all(places.map((place, i) => draw(place, data.panels[i], data.x))).then(together);
  });
  dark.addEventListener("change", () => {
    for (const [place, panel] of drawn) {
      const theme = themed(panel);
      Plotly.update(place, { "line.color": theme.lines }, theme.layout);
    }
  });
  Promise.all(charts).then(() => { document.documentElement.dataset.charts = "drawn"; });
})();
