// Recordings and what was made of them.
import { element } from "./parts.js";

const at = (id) => document.getElementById(id);

export async function showFiles(bench) {
  const response = await fetch("/api/files");
  if (!response.ok) return;
  const files = await response.json();
  const chosen = new Set([...document.querySelectorAll("#files input:checked")].map((box) => `${box.className} ${box.value}`));
  const rows = files.map((file) => {
    const isRecording = file.kind === "recording";
    const box = (kind) => {
      if (!isRecording) return "";
      return element("input", { type: "checkbox", class: kind, value: file.name, checked: chosen.has(`${kind} ${file.name}`), "aria-label": `${kind} ${file.name}` });
    };
    const address = `/files/${file.name.split("/").map(encodeURIComponent).join("/")}`;
    return element(
      "tr",
      {},
      element("td", {}, element("a", { href: address, target: "_blank", rel: "noopener" }, file.name)),
      element("td", { class: "text" }, file.kind),
      element("td", {}, box("train")),
      element("td", {}, box("held")),
      element("td", {}, file.bytes < 2048 ? `${file.bytes} B` : `${(file.bytes / 1024).toFixed(0)} kB`),
      element("td", {}, new Date(1000 * file.time_s).toLocaleTimeString()),
    );
  });
  const heads = ["file", "kind", "choose", "held out", "size", "written"];
  at("files").replaceChildren(
    element("thead", {}, element("tr", {}, ...heads.map((head, index) => element("th", { class: index === 1 ? "text" : "" }, head)))),
    element("tbody", {}, ...rows),
  );
}
