// Panes: plots one above the other, one for each unit, with a legend in each, onto which channels are dragged.
import { element, number } from "./parts.js";

// The first four are told apart without red or green, too (a distance of 37 in CIELAB at least, 3.4 to 1 against white); dashes change after them.
const COLOURS = ["#0f5ea8", "#d55e00", "#16202a", "#009e73", "#8f3fa0", "#b08a00"];
const APART = 4;
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]];
const DEGREES = 180 / Math.PI;
const SHOWN_AS = { rad: ["deg", DEGREES], "rad/s": ["deg/s", DEGREES], "rad/s^2": ["deg/s^2", DEGREES], m: ["mm", 1000], "m/s": ["mm/s", 1000] };
const FONT = "12px system-ui";

// In which unit the page shows angles and takes them, and who is told when that changes.
export const angles = () => localStorage.getItem("angles") || "deg";
export const whenAngles = (heed) => window.addEventListener("angles", heed);
export const scaleOf = (unit) => unit || "none";

// The unit in which a channel is shown, and how many of it are one of the channel's own.
export function shownAs(unit, of = angles()) {
  const asIs = SHOWN_AS[unit] === undefined || (of === "rad" && unit.startsWith("rad"));
  return asIs ? [unit, 1] : SHOWN_AS[unit];
}

// Of several things of two kinds each its colour by the one and its dashes by the other.
export function look(colour, dash) {
  return { stroke: COLOURS[colour % COLOURS.length], dash: DASHES[dash % DASHES.length] };
}

// Of several things each its own look.
export function lookOf(index) {
  return look(index, Math.floor(index / APART));
}

export function swatch({ stroke, dash }) {
  const made = element("span", { class: "swatch", "aria-hidden": "true" });
  made.innerHTML = `<svg width="30" height="8" viewBox="0 0 30 8"><path d="M0 4h30" fill="none" stroke="${stroke}" stroke-width="2.5" stroke-dasharray="${dash.join(" ")}"/></svg>`;
  return made;
}

// Boxes by unit, each of which chooses a channel and can be dragged onto a pane.
export function channelBoxes(names, unitOf, chosen, choose) {
  const groups = new Map();
  for (const name of names) {
    const unit = unitOf(name) || "no unit";
    groups.set(unit, [...(groups.get(unit) || []), name]);
  }
  return [...groups].flatMap(([unit, members]) => [element("h4", {}, unit), ...members.map((name) => {
    const box = element("input", { type: "checkbox", value: name, checked: chosen.has(name) });
    box.onchange = () => choose(name, box.checked);
    const label = element("label", { draggable: "true", title: "drag it onto a plot" }, box, name);
    label.ondragstart = (event) => event.dataTransfer.setData("text/plain", name);
    return label;
  })]);
}

// A pane with its legend: `series` have label, unit, stroke and dash; what is dropped onto it is told by its name.
export function pane(key, series, dropped) {
  const legend = series.map((one) => element("span", {}, swatch(one), one.label, " ", element("output", {})));
  const place = element("div", { class: "pane", "data-unit": key }, element("div", { class: "legend" }, ...legend));
  place.ondragover = (event) => event.preventDefault();
  place.ondrop = (event) => {
    event.preventDefault();
    dropped(event.dataTransfer.getData("text/plain"));
  };
  return place;
}

// What uPlot is told of a pane: an axis at the left for its own unit, others at the right.
export function options({ unit, series, width, height, xLabel, sync, drag = {}, hooks = {}, y = {} }) {
  const others = [...new Set(series.map((one) => one.unit))].filter((each) => each !== unit);
  const axis = (of, side) => ({
    scale: scaleOf(of), side, label: of ? `[${of}]` : "no unit", labelSize: 18, size: 64, space: 22, font: FONT, labelFont: FONT,
    grid: { show: side === 3 }, values: (_, ticks) => ticks.map((tick) => (tick === null ? "" : String(Number(tick.toPrecision(6))))),
  });
  return {
    width, height, legend: { show: false },
    cursor: { sync: { key: sync }, drag: { x: true, y: false, ...drag }, points: { size: 6 } },
    scales: { x: { time: false }, ...Object.fromEntries([unit, ...others].map((of) => [scaleOf(of), y])) },
    axes: [{ label: xLabel, labelSize: 18, size: 36, font: FONT, labelFont: FONT }, axis(unit, 3), ...others.map((of) => axis(of, 1))],
    series: [{}, ...series.map(({ label, unit: of, stroke, dash }) => ({ label, scale: scaleOf(of), width: 1.5, points: { show: false }, stroke, dash }))],
    hooks: { setCursor: [readOut], ...hooks },
  };
}

// Beside each name of the legend its value under the cursor; of curves over other times the nearest row.
function readOut(plot) {
  const { idx, left } = plot.cursor;
  plot.root.parentElement.querySelectorAll(".legend output").forEach((output, place) => {
    const column = plot.data[place + 1];
    const near = (away) => column[idx - away] ?? column[idx + away];
    const found = idx === null || left < 0 ? undefined : [0, 1, 2, 3, 4, 5, 6, 7].map(near).find((value) => value !== undefined && value !== null);
    output.textContent = found === undefined ? "" : number(found);
  });
}
