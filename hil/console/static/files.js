// Recordings, by date and experiment, and apart from them what was made of them.
import { element } from "./parts.js";

const at = (id) => document.getElementById(id);

function link(file) {
  const address = `/files/${file.name.split("/").map(encodeURIComponent).join("/")}`;
  return element("td", { class: "text" }, element("a", { href: address, target: "_blank", rel: "noopener" }, file.name));
}

function size(file) {
  return element("td", { class: "text" }, file.bytes < 2048 ? `${file.bytes} B` : `${(file.bytes / 1024).toFixed(0)} kB`);
}

const two = (value) => String(value).padStart(2, "0");

// Day and time of day at which a file was written.
function when(file) {
  const then = new Date(1000 * file.time_s);
  const day = `${then.getFullYear()}-${two(then.getMonth() + 1)}-${two(then.getDate())}`;
  return [`${then.toLocaleDateString("en", { weekday: "long" })}, ${day}`, `${two(then.getHours())}:${two(then.getMinutes())}:${two(then.getSeconds())}`];
}

const cell = (text) => element("td", { class: "text" }, text);

function fill(table, heads, rows, none) {
  const empty = element("tr", {}, element("td", { class: "text dim", colspan: heads.length }, none));
  table.replaceChildren(
    element("thead", {}, element("tr", {}, ...heads.map((head) => element("th", { class: "text" }, head)))),
    element("tbody", {}, ...(rows.length ? rows : [empty])),
  );
}

// Names of the recordings that are ticked, to train or held out.
export const ticked = (kind) => [...picked[kind]];
const picked = { train: new Set(), held: new Set() };

function tell() {
  const [chosen, held] = [ticked("train").length, ticked("held").length];
  at("chosen").textContent = !chosen ? "" : `${chosen} chosen, ${held ? `${held} held out` : "none held out: a diagnosis would not be tested"}`;
}

export async function showFiles(bench) {
  const response = await fetch("/api/files");
  if (!response.ok) return;
  const files = await response.json();
  const of = at("of-experiment").value;
  const box = (kind, file) => {
    const made = element("input", { type: "checkbox", class: kind, value: file.name, checked: picked[kind].has(file.name), "aria-label": `${kind} ${file.name}` });
    made.onchange = () => {
      if (made.checked) picked[kind].add(file.name);
      else picked[kind].delete(file.name);
      tell();
    };
    return element("td", { class: "text" }, made);
  };
  const recordings = files.filter((file) => file.kind === "recording");
  for (const names of Object.values(picked)) for (const name of names) if (!recordings.some((file) => file.name === name)) names.delete(name);
  const kinds = [...new Set(recordings.map((file) => file.experiment).filter(Boolean))].sort();
  at("of-experiment").replaceChildren(element("option", { value: "" }, "all experiments"),
    ...kinds.map((kind) => element("option", { selected: kind === of }, kind)));
  at("of-experiment").onchange = () => showFiles(bench);
  const heads = ["recorded", "experiment", "file", "choose", "held out", "size"];
  const rows = [];
  let last = "";
  for (const file of recordings.filter((each) => !of || each.experiment === of)) {
    const [day, time] = when(file);
    if (day !== last) rows.push(element("tr", { class: "day" }, element("th", { colspan: heads.length, scope: "rowgroup" }, day)));
    last = day;
    rows.push(element("tr", {}, cell(time), cell(file.experiment || "–"), link(file), box("train", file), box("held", file), size(file)));
  }
  const others = files.filter((file) => file.kind !== "recording").map((file) => element("tr", {}, cell(when(file).join(" ")), link(file), cell(file.kind), size(file)));
  fill(at("files"), heads, rows, "No recording yet: run a step or an experiment.");
  fill(at("others"), ["written", "file", "kind", "size"], others, "None.");
  tell();
}
