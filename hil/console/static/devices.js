// The state of every device: drives, brakes, I/O, IMU, bus, and how punctual the loop is.
import { shownAs } from "./panes.js";
import { element, number } from "./parts.js";

const at = (id) => document.getElementById(id);

export function showState(bench) {
  if (at("state").hidden) return;
  const { state, described } = bench;
  at("devices").replaceChildren(
    drives(state, described), safety(state, described), imu(state, described), bus(state, described), punctuality(state),
  );
}

function card(title, wide, ...inside) {
  return element("div", { class: wide ? "card wide" : "card" }, element("h3", {}, title), element("div", { class: "inside" }, ...inside));
}

function table(heads, rows) {
  return element(
    "div",
    { class: "scroll" },
    element(
      "table",
      {},
      element("thead", {}, element("tr", {}, ...heads.map((head) => element("th", {}, head)))),
      element("tbody", {}, ...rows.map((cells) =>
        element("tr", {}, ...cells.map((cell) => (cell instanceof Node ? cell : element("td", {}, cell)))))),
    ),
  );
}

function yes(is, words) {
  return element("td", { class: is ? "good" : "bad" }, words);
}

function drives(state, described) {
  const { nodes, trouble } = state.wire;
  const rows = nodes.map((node) => {
    const axis = described.axes.find((each) => each.name === node.axis);
    return [
      `${node.name} (${node.id})`,
      node.nmt || "–",
      element("td", { class: "wrap" }, node.state || "–"),
      node.position === undefined ? "–" : placed(node.position, axis),
      node.effort === undefined ? "–" : `${number(node.effort, 3)} ${axis ? axis.effort_unit : ""}`,
      element("td", { class: node.emergency ? "wrap bad" : "dim" }, node.emergency || (trouble ? "–" : "none")),
    ];
  });
  const note = trouble || "Heard on the bus. Between sessions the nodes are reset and silent.";
  return card("Drives and encoders", true, table(["node", "network", "state", "position", "effort", "emergency"], rows),
    element("p", { class: "note" }, note));
}

// In the unit in which the page shows angles, or mm.
function placed(position, axis) {
  if (!axis) return number(position, 6);
  const [unit, scale] = shownAs(axis.unit);
  return `${(scale * position).toFixed(3)} ${unit}`;
}

function safety(state, described) {
  const io = state.io || ioTold(state.live.told || state.work.told);
  if (!io) {
    const why = described.has_io ? "Polled while the machine is connected or runs; nobody asks it now." : "The machine file has no [bus.io].";
    return card("Brakes and I/O", false, element("p", { class: "note" }, why));
  }
  const rows = described.axes.map((axis) => [
    axis.name,
    element("td", {}, io.brakes_open[axis.name] ? "open" : "closed"),
    `${number(io.temperature_degC[axis.name], 3)} °C`,
  ]);
  return card(
    "Brakes and I/O",
    false,
    table(["axis", "brake", "temperature"], rows),
    table(["permission", ""], [
      ["hold-to-run", yes(io.hold_to_run, io.hold_to_run ? "pressed" : "released")],
      ["door", yes(io.door_closed, io.door_closed ? "closed" : "open")],
      ...(io.age_s === undefined ? [] : [["age of this state", `${(io.age_s * 1000).toFixed(0)} ms`]]),
    ]),
  );
}

// What a machine says of its I/O that is emulated in the run's own process, where nobody else can read it.
function ioTold(told) {
  if (!told || !told.io) return null;
  const of = (what) => Object.fromEntries(Object.entries(told.axes).map(([name, axis]) => [name, axis[what]]));
  const open = Object.fromEntries(Object.entries(of("brake")).map(([name, brake]) => [name, brake === "open"]));
  return { ...told.io, brakes_open: open, temperature_degC: of("temperature_degC") };
}

function imu(state, described) {
  const names = Object.keys(state.newest).filter((name) => /^(imu|gyro)_/.test(name));
  if (!names.length) {
    const why = described.has_imu ? "Its values are in the rows of a run; none was recorded yet." : "The machine file has no [bus.imu].";
    return card("IMU", false, element("p", { class: "note" }, why));
  }
  return card(
    "IMU",
    false,
    table(["channel", state.rows_are_now ? "now" : "last row"], names.map((name) => [name, number(state.newest[name], 5)])),
  );
}

function bus(state, described) {
  const { load, frames_Hz: frames, sync_Hz: sync, trouble } = state.wire;
  const heard = (text) => (trouble ? "–" : text); // nobody listens
  const meter = element("div", { class: "meter" }, element("i", { style: `width:${Math.min(100, 100 * load).toFixed(1)}%` }));
  return card(
    "Bus",
    false,
    table(["quantity", "value"], [
      ["load, worst stuffing", element("td", { "data-what": "load" }, heard(`${(100 * load).toFixed(1)} %`))],
      ["frames", heard(`${frames.toFixed(0)} /s`)],
      ["SYNC", `${heard(`${sync.toFixed(1)} Hz`)} of ${number(described.machine.rate_Hz, 4)} Hz`],
    ]),
    element("p", {}),
    meter,
    trouble ? element("p", { class: "note" }, trouble) : null,
  );
}

function punctuality(state) {
  const { measured, rows, missed, edges_us: edges } = state.timeliness;
  const parts = Object.values(measured).flatMap((each) => [
    element("p", { class: "note" }, `${each.title}: median ${time(each.p50_us)}, 99 % ${time(each.p99_us)}, 99.9 % ${time(each["p99.9_us"])}, ` +
      `largest ${time(each.max_us)}`),
    bars(each, edges),
  ]);
  const head = rows ? `${rows} rows, ${missed} ticks missed` : "Counted while a run is recorded.";
  const none = rows && !parts.length ? [element("p", { class: "note" }, "Virtual time is never late.")] : [];
  return card("Punctuality of the loop", true, element("p", {}, head), ...none, ...parts);
}

function time(us) {
  return us >= 1000 ? `${number(us / 1000, 3)} ms` : `${us.toFixed(0)} µs`;
}

// Bars over a logarithmic axis of time; heights are logarithmic too, so that a single late tick is seen.
function bars({ counts, title }, edges) {
  const [width, height] = [520, 130];
  const most = Math.log10(1 + Math.max(...counts));
  const step = width / counts.length;
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("class", "bars");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `histogram: ${title}, counts on a logarithmic scale`);
  counts.forEach((count, index) => {
    const tall = height * (Math.log10(1 + count) / most);
    const bar = document.createElementNS("http://www.w3.org/2000/svg", "rect");
    for (const [key, value] of Object.entries({ x: index * step, y: height - tall, width: step * 0.85, height: tall })) bar.setAttribute(key, value);
    svg.append(bar);
  });
  const labels = [1, 10, 100, 1000, 10000].map((us) => {
    const index = edges.findIndex((edge) => edge >= us * 0.999);
    return element("span", { style: `left:${(100 * index) / counts.length}%` }, us >= 1000 ? `${us / 1000} ms` : `${us} µs`);
  });
  return element("div", { class: "histogram" }, svg, element("div", { class: "ticks" }, ...labels));
}
