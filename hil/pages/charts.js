// Draws the charts of a page from the arrays packed into it. Charts of one group share zoom along x and the cursor.
(function () {
  "use strict";
  const packed = JSON.parse(document.getElementById("packed").textContent);
  const arrays = packed.arrays.map(() => null);
  const groups = new Map();
  const INK = "#333", RULE = "#e2e2e2", FONT = '12px system-ui, "DejaVu Sans", sans-serif';
  const POINTS_PER_PIXEL = 2; // a column of pixels shows a least and a greatest value
  const POINTS_MORE = 10; // of a cloud, whose extremes alone would look like two curves
  const Y_AXIS = 62, X_AXIS = 28, X_LABEL = 18;

  function bytes(text) {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }

  function array(number) { // decoded once, when a chart first needs it
    if (!arrays[number]) {
      const one = packed.arrays[number];
      if (one.f8 !== undefined) arrays[number] = new Float64Array(bytes(one.f8));
      else if (one.f4 !== undefined) {
        arrays[number] = new Float32Array(bytes(one.f4));
        arrays[number].middle = one.middle;
      } else arrays[number] = Float64Array.from({ length: one.count }, (_, i) => one.first + one.step * i);
      packed.arrays[number] = null;
    }
    return arrays[number];
  }

  function firstAtLeast(x, value) {
    let low = 0, high = x.length;
    while (low < high) {
      const mid = (low + high) >> 1;
      if (x[mid] < value) low = mid + 1; else high = mid;
    }
    return low;
  }

  // What of arrays over one x is drawn between two ends: all rows where pixels suffice, else the least and greatest of each column.
  // keep: "both" for curves and points, "low" and "high" for the edges of a band.
  function view(x, columns, ends, pixels, isLog) {
    const from = ends ? Math.max(0, firstAtLeast(x, ends[0]) - 1) : 0;
    const to = ends ? Math.min(x.length, firstAtLeast(x, ends[1]) + 2) : x.length;
    const rows = to - from, buckets = Math.max(1, Math.min(Math.floor(rows / 2), pixels));
    const value = (y, i) => {
      const v = y[i] + y.middle;
      return v === v && !(isLog && v <= 0) ? v : null;
    };
    if (rows <= POINTS_PER_PIXEL * pixels) {
      const out = [Array.from(x.subarray(from, to))];
      for (const column of columns) {
        const ys = new Array(rows);
        for (let i = 0; i < rows; i++) ys[i] = value(column.y, from + i);
        out.push(ys);
      }
      return out;
    }
    const edges = new Int32Array(buckets + 1), xs = new Array(2 * buckets);
    for (let b = 0; b <= buckets; b++) edges[b] = from + Math.floor((b * rows) / buckets);
    for (let b = 0; b < buckets; b++) {
      xs[2 * b] = x[edges[b]];
      xs[2 * b + 1] = x[edges[b + 1] - 1];
    }
    return [xs].concat(columns.map((column) => extremes(column.y, edges, column.keep, isLog)));
  }

  function extremes(y, edges, keep, isLog) {
    const buckets = edges.length - 1, out = new Array(2 * buckets), middle = y.middle, least = isLog ? -middle : -Infinity;
    for (let b = 0; b < buckets; b++) {
      let low = Infinity, high = -Infinity, lowAt = 0, highAt = 0;
      for (let i = edges[b]; i < edges[b + 1]; i++) {
        const v = y[i];
        if (!(v > least)) continue; // a hole, or nothing that a logarithm has
        if (v < low) { low = v; lowAt = i; }
        if (v > high) { high = v; highAt = i; }
      }
      if (low > high) { out[2 * b] = out[2 * b + 1] = null; continue; }
      const first = keep === "high" || (keep === "both" && highAt < lowAt) ? high : low;
      out[2 * b] = first + middle;
      out[2 * b + 1] = (keep === "both" ? (first === low ? high : low) : first) + middle;
    }
    return out;
  }

  function columnsOf(spec) { // as uPlot has them: the series, then a pair for each band
    return spec.series.map((one) => ({ x: one.x, y: array(one.y), keep: "both" })).concat(
      spec.bands.flatMap((one) => [{ x: one.x, y: array(one.low), keep: "low" }, { x: one.x, y: array(one.high), keep: "high" }]));
  }

  function dataOf(chart, ends) {
    const tables = new Map();
    chart.columns.forEach((column, place) => {
      if (!tables.has(column.x)) tables.set(column.x, { places: [], columns: [] });
      tables.get(column.x).places.push(place);
      tables.get(column.x).columns.push(column);
    });
    const more = chart.spec.series.some((one) => one.marker) ? POINTS_MORE : 1;
    const pixels = more * Math.max(50, chart.figure.clientWidth - Y_AXIS);
    const views = [...tables].map(([x, table]) => view(array(x), table.columns, ends, pixels, chart.spec.y.log));
    if (views.length === 1) return views[0];
    const joined = uPlot.join(views), out = [joined[0]];
    let at = 1;
    for (const table of tables.values()) for (const place of table.places) out[place + 1] = joined[at++];
    return out;
  }

  function number(v) {
    if (v === 0) return "0";
    const size = Math.abs(v);
    return size >= 1e6 || size < 1e-4 ? v.toExponential(2).replace(/\.?0+e/, "e") : String(+v.toPrecision(6));
  }

  const power = (v) => Math.abs(Math.log10(v) - Math.round(Math.log10(v))) < 1e-6;
  function logLabels(u, splits) { // powers of ten; 2 and 5 between them where there is room
    const few = splits.length && splits[splits.length - 1] / splits[0] < 200;
    return splits.map((v) => (power(v) || (few && [2, 5].includes(+(v / 10 ** Math.floor(Math.log10(v) + 1e-9)).toPrecision(3))) ? v : null));
  }

  function axis(scale, label, isX) {
    const filter = scale.log ? logLabels : undefined;
    return Object.assign(
      { stroke: INK, font: FONT, grid: { stroke: RULE, width: 1 }, ticks: { stroke: RULE, width: 1, size: 4 },
        values: (u, splits) => splits.map((v) => (v == null ? "" : number(v))) },
      filter ? { filter } : {},
      isX ? { label, labelSize: X_LABEL, labelFont: FONT, size: X_AXIS, labelGap: 0, space: 64 } : { size: Y_AXIS, space: 22 });
  }

  function around(u, low, high) { // a twentieth of room to either side, and something about what does not change
    if (low == null) return [0, 1];
    const room = high > low ? 0.05 * (high - low) : 0.1 * Math.abs(low) || 1;
    return [low - room, high + room];
  }

  function shape(ctx, marker, x, y, r) {
    if (marker === "circle" || marker === "ring") ctx.arc(x, y, r, 0, 2 * Math.PI);
    const lines = {
      cross: [[-r, -r, r, r], [-r, r, r, -r]], plus: [[-r, 0, r, 0], [0, -r, 0, r]], square: [[-r, -r, r, -r, r, r, -r, r, -r, -r]],
      triangle: [[0, -r, r, r, -r, r, 0, -r]], diamond: [[0, -r, r, 0, 0, r, -r, 0, 0, -r]] }[marker] || [];
    for (const line of lines) {
      ctx.moveTo(x + line[0], y + line[1]);
      for (let i = 2; i < line.length; i += 2) ctx.lineTo(x + line[i], y + line[i + 1]);
    }
  }

  function withinPlot(u, draw) {
    const ctx = u.ctx, box = u.bbox, scale = devicePixelRatio, inside = (x) => x >= box.left - 1 && x <= box.left + box.width + 1;
    ctx.save();
    ctx.beginPath();
    ctx.rect(box.left - 4 * scale, box.top - 4 * scale, box.width + 8 * scale, box.height + 8 * scale); // points on the edge are whole
    ctx.clip();
    draw(ctx, box, scale, inside);
    ctx.restore();
  }

  const drawPoints = (u, spec) => withinPlot(u, (ctx, box, scale, inside) => { // below the lines, which a cloud would hide
    spec.series.forEach((one, place) => {
      if (!one.marker || !u.series[place + 1].show) return;
      const many = u.data[0].length > 150;
      ctx.strokeStyle = ctx.fillStyle = one.colour;
      ctx.lineWidth = 1.3 * scale;
      ctx.beginPath();
      u.data[0].forEach((x, i) => {
        const y = u.data[place + 1][i];
        if (y == null) return;
        const left = u.valToPos(x, "x", true), r = (many ? 2 : 3) * scale, top = u.valToPos(y, "y", true);
        ctx.moveTo(left + r, top);
        if (inside(left)) shape(ctx, one.marker, left, top, r);
      });
      if (one.marker === "circle") ctx.fill(); else ctx.stroke();
    });
  });

  const drawMarks = (u, spec) => withinPlot(u, (ctx, box, scale, inside) => { // with their numbers
    ctx.font = `${11 * scale}px system-ui, sans-serif`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    let last = -Infinity, row = 0;
    spec.marks.map((x, i) => [x, i + 1]).sort((a, b) => a[0] - b[0]).forEach(([x, name]) => {
      const left = u.valToPos(x, "x", true);
      if (!inside(left)) return;
      row = left - last < 18 * scale ? row + 1 : 0; // neighbours' numbers stand below each other
      last = left;
      const top = box.top + (9 + 17 * (row % 4)) * scale;
      ctx.strokeStyle = INK;
      ctx.lineWidth = scale;
      ctx.setLineDash([3 * scale, 3 * scale]);
      ctx.beginPath();
      ctx.moveTo(left, box.top);
      ctx.lineTo(left, box.top + box.height);
      ctx.stroke();
      ctx.setLineDash([]);
      ctx.beginPath();
      ctx.arc(left, top, 7.5 * scale, 0, 2 * Math.PI);
      ctx.fillStyle = "#fff";
      ctx.fill();
      ctx.stroke();
      ctx.fillStyle = INK;
      ctx.fillText(String(name), left, top + 0.5 * scale);
    });
  });

  function nearest(values, at) { // where several x are joined most rows of a series are empty
    for (let away = 0; away < 12; away++) {
      if (values[at - away] != null) return values[at - away];
      if (values[at + away] != null) return values[at + away];
    }
    return null;
  }

  function readOut(chart) {
    const u = chart.u, at = u.cursor.idx, here = at != null && u.cursor.left >= 0;
    chart.outputs.forEach((output, place) => {
      const v = here ? nearest(u.data[place + 1], at) : null;
      output.textContent = v == null ? "" : number(v);
    });
    chart.at.textContent = here ? `at ${number(+u.posToVal(u.cursor.left, "x").toPrecision(5))}` : "";
  }

  function make(figure) {
    if (figure.drawn || figure.closest("details:not([open])")) return; // what is folded is drawn when it is opened
    figure.drawn = true;
    const spec = packed.charts[+figure.dataset.chart], plot = figure.querySelector(".plot");
    const key = spec.group || `chart ${figure.dataset.chart}`;
    if (!groups.has(key)) groups.set(key, { ends: null, charts: [], log: spec.x.log });
    const group = groups.get(key), chart = { figure, spec, group, columns: columnsOf(spec) };
    chart.outputs = [...figure.querySelectorAll(".legend button output")];
    chart.at = figure.querySelector(".at");
    const scale = (one) => Object.assign({ time: false }, one.log ? { distr: 3 } : {});
    const x = Object.assign(scale(spec.x), { range: (u, low, high) => group.ends || spec.x.ends || (high > low ? [low, high] : [low - 1, high + 1]) });
    const y = Object.assign(scale(spec.y), spec.y.ends ? { range: spec.y.ends } : spec.y.log ? {} : { range: around });
    const edge = { stroke: "transparent", width: 0, points: { show: false } };
    const first = spec.series.length + 1;
    chart.u = new uPlot({
      width: plot.clientWidth, height: spec.height, scales: { x, y }, legend: { show: false },
      axes: [axis(spec.x, spec.labels[0], true), axis(spec.y, "", false)],
      series: [{}].concat(
        spec.series.map((one) => ({ label: one.label, stroke: one.colour, width: 1.4, dash: one.dash, points: { show: false },
          paths: one.marker ? () => null : undefined, spanGaps: false })),
        spec.bands.flatMap(() => [edge, edge])),
      bands: spec.bands.map((_, k) => ({ series: [first + 2 * k + 1, first + 2 * k], fill: "rgba(120, 120, 120, 0.28)" })),
      cursor: {
        drag: { x: true, y: false, setScale: false }, points: { size: 6 },
        bind: { dblclick: () => () => zoom(group, null) },
        sync: { key, scales: ["x", null], setSeries: false, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } } },
      hooks: { drawAxes: [(u) => drawPoints(u, spec)], draw: [(u) => drawMarks(u, spec)], setCursor: [() => readOut(chart)], setSelect: [(u) => selected(u, group)] },
    }, dataOf(chart, group.ends), plot);
    group.charts.push(chart);
    figure.chart = chart;
    figure.querySelectorAll(".legend button").forEach((button, place) => button.addEventListener("click", () => {
      const show = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(show));
      chart.u.setSeries(place + 1, { show });
    }));
    figure.addEventListener("keydown", (event) => pressed(event, chart));
    new ResizeObserver(() => {
      if (plot.clientWidth && plot.clientWidth !== chart.u.width) {
        chart.u.setSize({ width: plot.clientWidth, height: spec.height });
        refresh(chart);
      }
    }).observe(plot);
  }

  function selected(u, group) {
    if (u.select.width > 3) zoom(group, [u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")]);
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
  }

  function refresh(chart) {
    chart.u.setData(dataOf(chart, chart.group.ends), true);
  }

  function whole(group) {
    const columns = group.charts.flatMap((chart) => chart.columns.map((column) => array(column.x)));
    return [Math.min(...columns.map((x) => x[0])), Math.max(...columns.map((x) => x[x.length - 1]))];
  }

  function zoom(group, ends) {
    group.ends = ends;
    group.charts.forEach(refresh);
  }

  function turn(group, does) { // a half, twice, a quarter to either side, or all
    if (does === "all" || !group.charts.length) return zoom(group, null);
    const to = group.log ? Math.log : (v) => v, from = group.log ? Math.exp : (v) => v;
    const all = whole(group).map(to), [low, high] = group.ends ? group.ends.map(to) : all;
    const width = (high - low) * { in: 0.5, out: 2, back: 1, on: 1 }[does], shift = (high - low) * ({ back: -0.25, on: 0.25 }[does] || 0);
    if (width >= all[1] - all[0]) return zoom(group, null);
    const start = Math.min(Math.max((low + high - width) / 2 + shift, all[0]), all[1] - width);
    zoom(group, [from(start), from(start + width)]);
  }

  function pressed(event, chart) {
    const does = { "+": "in", "=": "in", "-": "out", 0: "all", Home: "all" }[event.key];
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.target !== chart.figure || event.ctrlKey || event.metaKey || event.altKey || !(does || step)) return;
    event.preventDefault();
    if (does) return turn(chart.group, does);
    if (event.shiftKey) return turn(chart.group, step < 0 ? "back" : "on");
    const u = chart.u, at = Math.min(Math.max((u.cursor.left >= 0 ? u.cursor.left : u.over.clientWidth / 2) + 4 * step, 0), u.over.clientWidth);
    for (const other of chart.group.charts) other.u.setCursor({ left: at, top: other.u.over.clientHeight / 2 });
  }

  document.querySelectorAll(".tools button").forEach((button) =>
    button.addEventListener("click", () => groups.forEach((group) => turn(group, button.dataset.does))));
  const figures = [...document.querySelectorAll("figure.chart")], left = figures.slice();
  document.querySelectorAll("details").forEach((one) => one.addEventListener("toggle", () => one.querySelectorAll("figure.chart").forEach(make)));
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((one) => { one.open = true; });
    figures.forEach(make);
  });
  function some() { // what is on the screen first, the others between frames
    const until = performance.now() + 12;
    while (left.length && performance.now() < until) make(left.shift());
    if (left.length) setTimeout(some, 0); else requestAnimationFrame(() => requestAnimationFrame(() => { // the frame after the last chart's
      performance.mark("drawn");
      document.documentElement.dataset.drawn = "all";
    }));
  }
  some();
})();
