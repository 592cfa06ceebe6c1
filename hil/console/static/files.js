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

function written(file) {
  const then = new Date(1000 * file.time_s);
  const two = (value) => String(value).padStart(2, "0");
  const day = `${then.getFullYear()}-${two(then.getMonth() + 1)}-${two(then.getDate())}`;
  return element("td", { class: "text" }, `${day} ${two(then.getHours())}:${two(then.getMinutes())}:${two(then.getSeconds())}`);
}

function fill(table, heads, rows, none) {
  const empty = element("tr", {}, element("td", { class: "text dim", colspan: heads.length }, none));
  table.replaceChildren(
    element("thead", {}, element("tr", {}, ...heads.map((head) => element("th", { class: "text" }, head)))),
    element("tbody", {}, ...(rows.length ? rows : [empty])),
  );
}

export async function showFiles(bench) {
  const response = await fetch("/api/files");
  if (!response.ok) return;
  const files = await response.json();
  const chosen = new Set([...document.querySelectorAll("#files input:checked")].map((box) => `${box.className} ${box.value}`));
  const box = (kind, file) =>
    element("td", { class: "text" }, element("input", {
      type: "checkbox", class: kind, value: file.name, checked: chosen.has(`${kind} ${file.name}`), "aria-label": `${kind} ${file.name}`,
    }));
  const recordings = files.filter((file) => file.kind === "recording").map((file) =>
    element("tr", {}, written(file), element("td", { class: "text" }, file.experiment || "–"), link(file), box("train", file), box("held", file), size(file)));
  const others = files.filter((file) => file.kind !== "recording").map((file) =>
    element("tr", {}, written(file), link(file), element("td", { class: "text" }, file.kind), size(file)));
  fill(at("files"), ["recorded", "experiment", "file", "choose", "held out", "size"], recordings, "No recording yet: run a step or an experiment.");
  fill(at("others"), ["written", "file", "kind", "size"], others, "None.");
}
