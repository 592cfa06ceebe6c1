// The guided commissioning and the forms of experiments: both show a plan before anything moves.
import { angles, whenAngles } from "./panes.js";
import { ask, element, replaceIfNew } from "./parts.js";

const MARKS = { passed: "✔ passed", bad: "! not passed", failed: "✘ failed", stopped: "■ stopped", running: "▶ running", todo: "to do" };
const AGAIN = {
  bad: (mend) => `It was done, and its answer is not good enough to build on. ${mend} Then start this step again.`,
  failed: () => "It could not be done, for the reason above. Mend that, see that power, emergency stop, door and hold-to-run are as they should be, then start this step again.",
  stopped: () => "It was stopped. See that the machine is as it should be, then start this step again.",
};
const at = (id) => document.getElementById(id);
const cards = new Map(); // name of a step or "form kind" -> its parts

export function showSteps(bench, place) {
  bench.described.steps.forEach((step, index) => {
    const form = fieldsOf(step.fields);
    const start = element("button", { type: "button", class: "start" }, step.moves ? "Start: the machine moves" : "Start");
    const plan = element("div", {});
    const result = element("div", { class: "result" });
    const mark = element("span", { class: "mark" }, MARKS.todo);
    const why = element("span", { class: "why" });
    const advice = element("p", { class: "advice" });
    const card = element(
      "details",
      { class: "card", "data-step": step.name },
      element("summary", {}, mark, element("span", {}, `${index + 1}. ${step.title}`), why),
      element(
        "div",
        { class: "inside" },
        element("ul", {}, ...step.does.map((line) => element("li", {}, line))),
        form.box,
        plan,
        advice,
        start,
        result,
      ),
    );
    const part = { card, start, mark, advice, why, result, step, planned: !step.experiment, seen: "" };
    if (step.experiment) planner(bench, part, step.experiment, form, plan, () => card.open);
    card.addEventListener("toggle", () => card.open && part.show && part.show());
    start.onclick = () => begin(bench, part, "/api/step", { step: step.name, values: form.values() });
    cards.set(step.name, part);
    place.append(card);
  });
}

export function showForms(bench, place) {
  for (const kind of bench.described.forms) {
    const form = fieldsOf(kind.fields);
    const start = element("button", { type: "button", class: "start" }, "Run: the machine moves");
    const plan = element("div", {});
    const result = element("div", { class: "result" });
    const card = element(
      "details",
      { class: "card", "data-form": kind.kind, name: "form" },
      element("summary", {}, element("span", {}, kind.title), element("span", { class: "why" }, kind.says)),
      element("div", { class: "inside" }, form.box, plan, start, result),
    );
    const part = { card, start, result, planned: false };
    planner(bench, part, kind.kind, form, plan, () => card.open);
    card.addEventListener("toggle", () => card.open && part.show());
    start.onclick = () => begin(bench, part, "/api/run", { kind: kind.kind, values: form.values() });
    cards.set(`form ${kind.kind}`, part);
    place.append(card);
  }
}

function fieldsOf(fields) {
  const inputs = fields.map((field) => {
    const attributes = { name: field.name };
    if (field.choices.length) {
      const options = field.choices.map((choice) => element("option", { selected: choice === field.value }, choice));
      return element("select", attributes, ...options);
    }
    return element("input", { ...attributes, type: "number", step: field.whole ? 1 : "any", value: field.value });
  });
  const names = fields.map((field) => element("span", {}, field.unit));
  const labels = fields.map((field, index) =>
    element("label", {}, field.label, element("span", { class: "entry" }, inputs[index], names[index])),
  );
  let shown = "deg"; // in which the entries of angles are; the server takes degrees
  const inDegrees = (input) => (input.isAngle && shown === "rad" ? rounded((input.value * 180) / Math.PI, 9) : Number(input.value));
  const show = () => {
    for (const [index, input] of inputs.entries()) {
      input.isAngle = fields[index].unit.startsWith("deg");
      if (!input.isAngle || shown === angles()) continue;
      input.value = angles() === "rad" ? rounded((input.value * Math.PI) / 180, 12) : inDegrees(input);
      names[index].textContent = fields[index].unit.replace("deg", angles());
    }
    shown = angles();
  };
  show();
  whenAngles(show);
  const box = element("div", { class: fields.length ? "fields" : "" }, ...labels);
  const values = () =>
    Object.fromEntries(inputs.map((input) => [input.name, input.type === "number" ? inDegrees(input) : input.value]));
  return { box, values, listen: (heed) => inputs.forEach((input) => input.addEventListener("input", heed)) };
}

const rounded = (value, digits) => Number(value.toPrecision(digits));

// Shows the plan of a form whenever it changes; what has no plan cannot be started.
function planner(bench, part, kind, form, place, isOpen) {
  let [asked, timer] = ["", 0];
  const card = JSON.stringify(part.card.dataset);
  part.show = async () => {
    const values = form.values();
    const key = JSON.stringify(values);
    if (key === asked) return;
    asked = key;
    part.planned = false;
    place.className = "plan";
    place.replaceChildren(element("p", {}, "planning ..."));
    enable(bench, part);
    let found;
    try {
      found = await ask("/api/preview", { kind, values, card }, bench.client);
    } catch (error) {
      found = { refused: error.message };
    }
    if (asked !== key) return;
    place.replaceChildren(...planLines(found));
    if (found.again) {
      asked = "";
      setTimeout(() => isOpen() && part.show(), 1000);
    }
    place.className = found.refused ? "plan refused" : "plan";
    part.planned = !found.refused;
    enable(bench, part);
  };
  form.listen(() => {
    part.planned = false;
    enable(bench, part);
    clearTimeout(timer);
    timer = setTimeout(() => isOpen() && part.show(), 500);
  });
}

function planLines(found) {
  const lines = [];
  if (found.refused) lines.push(element("p", {}, element("b", {}, "Refused before anything moves: "), found.refused));
  else {
    const seconds = found.recordings.reduce((sum, each) => sum + each.seconds, 0);
    const count = found.recordings.length;
    lines.push(
      element("p", {}, element("b", {}, `${count} recording${count > 1 ? "s" : ""}, ${seconds.toFixed(1)} s recorded in all`),
        "; boot, homing, way and standstill come before each."),
    );
    for (const note of new Set(found.recordings.flatMap((each) => each.notes))) lines.push(element("p", { class: "peak" }, note));
  }
  if (found.text) {
    lines.push(element("details", { class: "more" }, element("summary", {}, "the experiment file"), element("pre", {}, found.text)));
  }
  return lines;
}

async function begin(bench, part, where, what) {
  part.start.disabled = true;
  try {
    await ask(where, what, bench.client);
    part.result.replaceChildren();
    delete part.result.dataset.key;
  } catch (error) {
    part.result.replaceChildren(element("div", { class: "plan refused" }, error.message));
    delete part.result.dataset.key;
  }
}

function enable(bench, part) {
  const busy = bench.state && (bench.state.work.state === "running" || (bench.state.stop && bench.state.stop.seconds === null));
  part.start.disabled = !part.planned || Boolean(busy);
}

// What each step is at; of the one that runs, the work.
function stepsNow({ work, steps }) {
  return Object.entries(steps).map(([name, result]) => [name, work.state === "running" && work.step === name ? work : result]);
}

// The first step that has yet to pass; "" once all have.
export function dueStep(state) {
  return (stepsNow(state).find(([, now]) => now.state !== "passed") || [""])[0];
}

// The first form, unless a reader has opened one.
let isOpened = false;
export function openForm() {
  const forms = [...cards.values()].filter((part) => !part.step).map((part) => part.card);
  if (!isOpened && !forms.some((card) => card.open)) forms[0].open = true;
  isOpened = true;
}

export function updateSteps(bench) {
  const { work } = bench.state;
  const [nows, due] = [stepsNow(bench.state), dueStep(bench.state)];
  at("steps-done").hidden = due !== "";
  for (const [name, now] of nows) {
    const part = cards.get(name);
    const state = now.state || "todo";
    part.card.className = `card ${state}`;
    part.mark.textContent = state === "todo" && name === due ? "next" : MARKS[state];
    part.start.textContent = (part.step.moves ? "Start: the machine moves" : "Start").replace("Start", state in AGAIN ? "Start again" : "Start");
    part.why.textContent = now.why || "";
    part.advice.textContent = state in AGAIN ? AGAIN[state](part.step.mend) : "";
    unfold(part, state, name === due);
    if (!now.state) continue;
    const lines = now.lines || [];
    replaceIfNew(part.result, `${state} ${lines.length} ${lines.length ? lines[lines.length - 1][0] : ""}`, () => evidence(now, state === "running"));
  }
  for (const [name, part] of cards) {
    enable(bench, part);
    // one coloured button on the page: of the step that is due; of a form only once no step is
    const isDue = due === "" ? !part.step && part.card.open : name === due;
    part.start.classList.toggle("main", isDue && work.state !== "running");
  }
}

// A step that has passed folds away with its evidence, and the one that is due opens: once, so that a reader may open and close what he likes.
function unfold(part, state, due) {
  const seen = `${state} ${due}`;
  if (part.seen === seen) return;
  const isLater = part.seen !== "";
  part.seen = seen;
  part.card.open = due || state === "running";
  if (due && isLater && part.card.offsetParent) part.card.scrollIntoView({ block: "nearest" });
}

function evidence(now, open) {
  const text = element("pre", {});
  for (const [line, isError] of now.lines) {
    text.append(element("span", { class: line.startsWith("$ ") ? "asked" : isError && line.startsWith("isocenter: ") ? "bad" : "" }, `${line}\n`));
  }
  const made = (now.made || []).map((name) => {
    const address = `/files/${encodeURIComponent(name)}?${Date.now()}`;
    const shown = name.endsWith(".png") ? element("img", { src: address, alt: name, loading: "lazy" }) : `report: ${name}`;
    return element("p", { class: "made" }, element("a", { href: address, target: "_blank", rel: "noopener" }, shown));
  });
  return [element("details", { class: "more", open: open || now.state !== "passed" }, element("summary", {}, "evidence: what was said"), text), ...made];
}
