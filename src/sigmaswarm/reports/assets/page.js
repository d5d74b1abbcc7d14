"use strict";
(async () => {
  const el = (id) => document.getElementById(id);
  const data = el("data") && JSON.parse(await unpacked("data"));
  // On touch screens a drag scrolls the page, and the fields "from" and "to" zoom.
  const TOUCH = matchMedia("(pointer: coarse)").matches;
  const EXPLORED = { responsive: true, displaylogo: false, modeBarButtons: [["zoom2d", "pan2d", "resetScale2d"]] };
  const PAPER_WIDTH = 660; // px of an A4 page between its margins

  const axis = (more) => ({ gridcolor: "#e6e8ea", zerolinecolor: "#c4c9ce", linecolor: "#a9b0b7", ...more });
  const layout = (more) => ({
    font: { family: "system-ui, sans-serif", size: 13, color: "#1c2024" },
    paper_bgcolor: "#fff", plot_bgcolor: "#fff", hovermode: "closest", dragmode: TOUCH ? false : "zoom",
    legend: { orientation: "h", y: -0.25 }, height: 360, ...more,
    margin: { l: 56, r: 12, t: 12, b: 44, ...more.margin },
    xaxis: axis(more.xaxis), yaxis: axis(more.yaxis),
  });

  async function unpacked(id) {
    const bytes = Uint8Array.from(atob(el(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  }

  async function loadPlotly() {
    const script = document.createElement("script");
    script.textContent = await unpacked("plotly");
    document.head.append(script);
  }

  // ---- tables ----

  function sortBy(table, column, header) {
    const descending = header.getAttribute("aria-sort") === "ascending";
    for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    header.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const key = (row) => {
      const cell = row.cells[column];
      if (cell.dataset.value !== undefined) return Number(cell.dataset.value);
      return cell.classList.contains("number") ? null : cell.textContent;
    };
    const compare = (a, b) => {
      if (a === null || b === null) return (a === null) - (b === null); // unknown values are last
      if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
      const order = typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true });
      return descending ? -order : order;
    };
    const body = table.tBodies[0];
    body.append(...[...body.rows].sort((a, b) => compare(key(a), key(b))));
  }

  function makeSortable() {
    for (const table of document.querySelectorAll("table.sortable")) {
      [...table.tHead.rows[0].cells].forEach((header, column) => {
        if ([...table.tBodies[0].rows].some((r) => r.cells[column].dataset.value)) header.classList.add("number");
        header.firstElementChild.addEventListener("click", () => sortBy(table, column, header));
      });
    }
  }

  // ---- tracks and errors ----

  const LINES = data?.lines ?? [];
  const DRAWN = LINES.map((line) => line.series).reverse(); // from bottom to top
  const look = (name) => LINES.find((line) => line.series === name);
  const state = { drive: null, window: null, known: true }; // known: the drive has truth

  const shown = (name) => el(`method-${name}`)?.checked && state.drive.series[name];
  const inWindow = (t) => !state.window || (t >= state.window[0] && t <= state.window[1]);
  const style = (name) => {
    const { color, dash, width } = look(name);
    return dash === "none"
      ? { mode: "markers", marker: { color, size: 5, opacity: 0.7 } }
      : { mode: "lines", line: { color, dash, width } };
  };

  function pathTrace(name) {
    const s = state.drive.series[name];
    const kept = s.time.map((_, i) => i).filter((i) => inWindow(s.time[i]));
    const pick = (column) => kept.map((i) => column[i]);
    return {
      x: pick(s.x), y: pick(s.y), customdata: pick(s.time), name: look(name).label, ...style(name),
      hovertemplate: "%{x:.1f} m, %{y:.1f} m at %{customdata:.1f} s",
    };
  }

  // Truth and fixes set the range of the map, since a diverged method would hide the others.
  function frame() {
    const ends = (column) => {
      let [low, high] = [Infinity, -Infinity];
      for (const name of ["truth", "raw_gps"]) {
        const s = state.drive.series[name];
        (s?.time ?? []).forEach((t, i) => {
          if (inWindow(t) && s[column][i] !== null) [low, high] = [Math.min(low, s[column][i]), Math.max(high, s[column][i])];
        });
      }
      return [low, high];
    };
    const [x, y] = [ends("x"), ends("y")];
    if (!Number.isFinite(x[0])) return [undefined, undefined];
    const margin = Math.max(0.08 * Math.max(x[1] - x[0], y[1] - y[0]), 1);
    return [x, y].map(([low, high]) => [low - margin, high + margin]);
  }

  function drawMap() {
    const [x, y] = frame();
    const moment = { x: [], y: [], name: "this moment", mode: "markers", hoverinfo: "skip",
      marker: { color: "#fff", size: 11, line: { color: "#1c2024", width: 2.5 } } };
    Plotly.react("map", [...DRAWN.filter(shown).map(pathTrace), moment], layout({
      height: 440, showlegend: false, margin: { l: 60 },
      xaxis: { title: { text: "east, m" }, range: x },
      yaxis: { title: { text: "north, m" }, range: y, scaleanchor: "x" },
    }), EXPLORED);
  }

  const GREY = { mode: "lines", hoverinfo: "skip", line: { color: "#8a9199", width: 1 } };

  function bounds(column, mirrored) {
    const s = state.drive.series[el("sigma").value];
    if (!s?.[column]) return [];
    const above = { ...GREY, x: s.time, y: s[column], name: "3 sigma" };
    if (!mirrored) return [above];
    return [above, { ...GREY, x: s.time, y: s[column].map((v) => (v === null ? v : -v)), name: "-3 sigma",
      fill: "tonexty", fillcolor: "rgba(138,145,153,.18)" }];
  }

  function errorsOf(column) {
    return DRAWN.filter((n) => shown(n)?.[column]).map((name) => ({
      x: state.drive.series[name].time, y: state.drive.series[name][column], name: look(name).label, ...style(name) }));
  }

  function nisTraces() {
    const nis = state.drive.series[`${el("sigma").value}.nis`];
    if (!nis) return [];
    return [{ x: nis.time, y: nis.nis, name: "NIS", mode: "markers",
      marker: { color: look(el("sigma").value).color, size: 4 } }];
  }

  const finite = (traces) => traces.flatMap((t) => t.y).filter((v) => v !== null);

  // Panels of position, heading and NIS; empty panels are left out.
  function panels() {
    const position = [...bounds("position_3sigma", false), ...errorsOf("position_error")];
    const heading = [...bounds("heading_3sigma", true), ...errorsOf("heading_error")];
    const what = state.known ? "" : " 3 sigma";
    return [
      { title: `position${what}, m`, traces: position, scale: { type: "log", range: positionRange(position) } },
      { title: `heading${what}, deg`, traces: heading, scale: { range: headingRange(heading) } },
      { title: "NIS", traces: nisTraces(), scale: { type: "log", range: logRange(nisTraces(), 0.01, 20) }, gate: true },
    ].filter((panel) => finite(panel.traces).length);
  }

  const PANEL_HEIGHT = 188; // px
  const GAP = 0.04; // between panels, as a share of the plot's height

  function drawErrors() {
    const drawn = panels();
    const height = (1 - GAP * (drawn.length - 1)) / drawn.length;
    const origin = state.drive.origin ? ` since t = ${state.drive.origin} s` : "";
    const wanted = { ...layout({ height: 56 + PANEL_HEIGHT * Math.max(drawn.length, 1), showlegend: false, margin: { l: 60 } }) };
    const traces = drawn.flatMap((panel, i) => {
      const id = i ? `${i + 1}` : "";
      const top = 1 - i * (height + GAP);
      wanted[`yaxis${id}`] = axis({ title: { text: panel.title, font: { size: 12 } },
        domain: [Math.max(top - height, 0), top], ...panel.scale });
      if (panel.gate) {
        wanted.shapes = [{ type: "line", xref: "paper", x0: 0, x1: 1, yref: `y${id}`, y0: data.gate, y1: data.gate,
          line: { color: "#51585f", width: 1, dash: "dash" } }];
      }
      return panel.traces.map((trace) => ({ ...trace, yaxis: `y${id}` }));
    });
    // The time axis is below the lowest panel.
    wanted.xaxis = axis({ title: { text: `time, s${origin}` }, anchor: drawn.length > 1 ? `y${drawn.length}` : "y",
      zeroline: false, ...(state.window ? { range: state.window } : { autorange: true }) });
    if (!drawn.length) {
      wanted.xaxis = { visible: false };
      wanted.yaxis = { visible: false };
      wanted.annotations = [{ text: "Nothing to draw: choose a filter above.", xref: "paper", yref: "paper",
        x: 0.5, y: 0.5, showarrow: false }];
    }
    Plotly.react("errors", traces, wanted, EXPLORED);
  }

  // Range from a negligible value to the largest value, as exponents of ten for plotly.js.
  function logRange(traces, low, high) {
    return [low, finite(traces).reduce((a, b) => Math.max(a, 1.3 * b), high)].map(Math.log10);
  }

  // Without errors, the bounds set the range.
  function positionRange(traces) {
    const values = finite(traces).filter((v) => v > 0);
    if (state.known || !values.length) return logRange(traces, 0.03, 1);
    return logRange(traces, values.reduce((a, b) => Math.min(a, b)) / 1.5, 0);
  }

  // The main filter sets the range, since the heading of a diverged method would hide the others.
  function headingRange(traces) {
    const errors = state.known ? [{ y: state.drive.series[data.main]?.heading_error ?? [] }] : traces;
    const most = finite(errors).map(Math.abs).reduce((a, b) => Math.max(a, b), state.known ? 4 : 0.1);
    return [-1, 1].map((side) => side * Math.min(180, 1.2 * most));
  }

  function setWindow(wanted) {
    state.window = wanted;
    const [low, high] = wanted ?? wholeTime();
    [el("from").value, el("to").value] = [low, high].map((v) => v.toFixed(2));
    el("limits").textContent = "";
  }

  function wholeTime() {
    const times = Object.values(state.drive.series).map((s) => s.time);
    return [Math.min(...times.map((t) => t[0])), Math.max(...times.map((t) => t[t.length - 1]))];
  }

  function draw() {
    drawMap();
    drawErrors();
  }

  function showMoment(t) {
    const name = [data.main, "truth", "raw_gps"].find((n) => state.drive.series[n]);
    const s = state.drive.series[name];
    const at = s.time.findIndex((v) => v >= t);
    const last = el("map").data.length - 1;
    Plotly.restyle("map", at < 0 ? { x: [[]], y: [[]] } : { x: [[s.x[at]]], y: [[s.y[at]]] }, [last]);
  }

  function chooseDrive() {
    state.drive = data.drives[Number(el("drive").value)];
    state.known = finite(Object.values(state.drive.series).map((s) => ({ y: s.position_error ?? [] }))).length > 0;
    el("over-time").textContent = state.known ? "Errors over time" : "3 sigma over time";
    el("no-truth").hidden = state.known;
    for (const name of DRAWN) el(`method-${name}`).disabled = !state.drive.series[name];
    setWindow(null);
    draw();
  }

  const option = (value, text) => Object.assign(document.createElement("option"), { value, textContent: text });

  // Lengths of dashes as in plotly.js.
  const DASHES = { solid: "", dash: "9 9", dashdot: "9 3 3 3", dot: "3 3" };

  function swatch(color, dash) {
    const svg = (kind, attributes) => {
      const node = document.createElementNS("http://www.w3.org/2000/svg", kind);
      Object.entries(attributes).forEach(([key, value]) => node.setAttribute(key, value));
      return node;
    };
    const picture = svg("svg", { class: "swatch", viewBox: "0 0 27 6", "aria-hidden": "true" });
    if (dash === "none") picture.append(...[4, 13.5, 23].map((cx) => svg("circle", { cx, cy: 3, r: 2.5, fill: color })));
    else picture.append(svg("line", { x1: 0, x2: 27, y1: 3, y2: 3, stroke: color, "stroke-width": 2.5, "stroke-dasharray": DASHES[dash] }));
    return picture;
  }

  function makeControls() {
    data.drives.forEach((drive, i) => el("drive").append(option(i, drive.name)));
    for (const { series, label } of LINES) {
      if (data.drives.some((drive) => drive.series[series]?.position_3sigma)) el("sigma").append(option(series, label));
    }
    el("sigma").append(option("", "none"));
    el("sigma").value = data.main;
    for (const { series, label: text, color, dash, shown: checked } of LINES) {
      const box = Object.assign(document.createElement("input"), { type: "checkbox", id: `method-${series}`, checked });
      const label = document.createElement("label");
      label.append(box, swatch(color, dash), text);
      el("methods").append(label);
    }
    el("drive").addEventListener("change", chooseDrive);
    el("sigma").addEventListener("change", drawErrors);
    el("methods").addEventListener("change", draw);
    el("whole").addEventListener("click", () => { setWindow(null); draw(); });
    el("window").addEventListener("change", (event) => askForWindow(event.target.id));
  }

  // The fields show the drawn window. Invalid input is reset; an empty field means the end of the drive.
  function askForWindow(changed) {
    const whole = wholeTime();
    const wanted = ["from", "to"].map((id, i) => {
      if (el(id).validity.badInput) return NaN;
      return el(id).value === "" ? whole[i] : Number(el(id).value);
    });
    const kept = [Math.max(wanted[0], whole[0]), Math.min(wanted[1], whole[1])];
    // A later "from" is usually entered before a later "to", so the old "to" is dropped.
    if (changed === "from" && kept[0] >= kept[1]) kept[1] = whole[1];
    const sound = kept[0] < kept[1];
    const asIs = sound && kept.every((v, i) => Math.abs(v - wanted[i]) < 0.01);
    setWindow(sound ? kept : state.window);
    el("limits").textContent = asIs ? "" : `from before to, within ${whole.map((v) => v.toFixed(2)).join(" to ")} s`;
    if (sound) draw();
  }

  function linkTime() {
    el("errors").on("plotly_relayout", (change) => {
      const low = change["xaxis.range[0]"], high = change["xaxis.range[1]"];
      if (low !== undefined) setWindow([low, high]);
      else if (change["xaxis.autorange"]) setWindow(null);
      else return;
      drawMap();
    });
    el("errors").on("plotly_hover", (event) => showMoment(event.points[0].x));
    el("errors").on("plotly_unhover", () => showMoment(Infinity));
  }

  // ---- copying the command, and printing ----

  async function copyCommand() {
    const text = el("command").textContent;
    try {
      await navigator.clipboard.writeText(text);
    } catch { // an old browser, or a browser that forbids this for local files
      const area = Object.assign(document.createElement("textarea"), { value: text });
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    el("copy").textContent = "Copied";
    setTimeout(() => { el("copy").textContent = "Copy"; }, 2000);
  }

  function fitPaper() {
    const print = matchMedia("print");
    const plots = () => [...document.querySelectorAll(".js-plotly-plot")];
    const fit = () => plots().forEach((p) => Plotly.relayout(p, { width: Math.min(PAPER_WIDTH, p.clientWidth) }));
    const back = () => plots().forEach((p) => Plotly.relayout(p, { width: null, autosize: true }));
    print.addEventListener("change", () => (print.matches ? fit() : back()));
  }

  makeSortable();
  el("copy")?.addEventListener("click", copyCommand);
  if (data) {
    await loadPlotly();
    makeControls();
    chooseDrive();
    linkTime();
    fitPaper();
  }
  document.body.dataset.ready = "";
})();
