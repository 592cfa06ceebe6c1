// The scope: rows as they come, in panes by unit, with trigger, pause, zoom and cursors.
import { channelBoxes, lookOf, options, pane, scaleOf, shownAs, swatch, whenAngles } from "./panes.js";
import { element, number } from "./parts.js";
import { Ring, drawable, measure } from "./ring.js";

const at = (id) => document.getElementById(id);
const HEADER_BYTES = 24;
const DRAW_MS = 60;
const READ_MS = 400;
const SPEED_S = 0.05;
const BEFORE = 0.2; // share of the span before the trigger
const FIRST = ["position_", "command_", "imu_x", "imu_y", "imu_z"];
const LEFT_OUT = new Set(["time", "imu_time"]);

export class Scope {
  constructor() {
    this.ring = null;
    this.chosen = new Set(JSON.parse(localStorage.getItem("channels") || "null") || []);
    this.paused = null; // { from, to } of the view [s] while it stands still
    this.caught = null; // trigger's view
    this.marks = [];
    this.panes = new Map();
    this.placed = new Map(); // channel -> the pane onto which it was dragged
    this.lost = 0;
    this.isVisible = false;
    this.drawnEnd = -1;
    this.lastRead = 0;
    this.info = "";
    at("pause").onclick = () => this.pause(this.paused === null);
    whenAngles(() => {
      if (this.ring) this.list(this.ring.names.filter((name) => !LEFT_OUT.has(name)));
      this.build();
    });
    at("cursors").onchange = () => {
      this.marks = [];
      this.dirty();
    };
    for (const id of ["span", "trigger-channel", "trigger-edge", "trigger-level", "trigger-mode"]) {
      at(id).onchange = () => {
        this.caught = null;
        if (id === "span" && this.paused) this.paused.from = this.paused.to - this.span;
        this.dirty();
      };
    }
    at("earlier").onclick = () => this.move(-0.25, 1);
    at("later").onclick = () => this.move(0.25, 1);
    at("closer").onclick = () => this.move(0, 0.5);
    at("wider").onclick = () => this.move(0, 2);
    new ResizeObserver(() => this.resize()).observe(at("panes"));
    if (window.innerWidth < 900) at("channels").open = false;
    setInterval(() => this.draw(), DRAW_MS);
    this.note();
  }

  open(address) {
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => (typeof event.data === "string" ? this.begin(JSON.parse(event.data)) : this.take(event.data));
    socket.onclose = () => setTimeout(() => this.open(address), 500);
  }

  told(state) {
    this.rate = state.timeliness.rows;
    this.recording = state.recording;
  }

  begin(told) {
    this.number = told.number;
    this.ring = new Ring(told.channels, 256);
    this.name = told.name;
    this.paused = this.caught = null;
    this.marks = [];
    this.lost = 0;
    const names = this.ring.names.filter((name) => !LEFT_OUT.has(name));
    if (![...this.chosen].some((name) => names.includes(name))) {
      this.chosen = new Set(names.filter((name) => FIRST.some((first) => name.startsWith(first))));
    }
    this.list(names);
    this.pause(false);
    this.build();
  }

  // Speed of an axis by the newest rows; NaN where they do not tell it.
  speedOf(axis) {
    return this.ring ? this.ring.rate(`position_${axis}`, SPEED_S) : NaN;
  }

  take(buffer) {
    const head = new DataView(buffer);
    if (!this.ring || head.getUint32(0, true) !== this.number) return;
    this.lost = head.getUint32(12, true);
    this.ring.put(new Float64Array(buffer, HEADER_BYTES));
  }

  list(names) {
    at("channel-list").replaceChildren(...channelBoxes(names, (name) => this.unit(name), this.chosen, (name, is) => {
      this.placed.delete(name);
      this.choose(name, is);
    }));
    const before = at("trigger-channel").value;
    at("trigger-channel").replaceChildren(
      element("option", { value: "" }, "off"),
      ...names.map((name) => element("option", { value: name }, name)),
    );
    at("trigger-channel").value = names.includes(before) ? before : "";
  }

  choose(name, is) {
    if (is) this.chosen.add(name);
    else this.chosen.delete(name);
    localStorage.setItem("channels", JSON.stringify([...this.chosen]));
    this.build();
  }

  // A channel that was dragged onto a plot is drawn there, on an axis of its own where its unit is another.
  drop(name, onto) {
    if (!this.ring || !this.ring.names.includes(name)) return;
    this.placed.set(name, onto);
    for (const box of document.querySelectorAll("#channel-list input")) if (box.value === name) box.checked = true;
    this.choose(name, true);
  }

  get shown() {
    return this.ring ? this.ring.names.filter((name) => this.chosen.has(name)) : [];
  }

  unit(name) {
    return shownAs(this.ring.units[name])[0];
  }

  scale(name) {
    return shownAs(this.ring.units[name])[1];
  }

  get span() {
    return Number(at("span").value);
  }

  style(name) {
    return { label: name, unit: this.unit(name), ...lookOf(this.shown.indexOf(name)) };
  }

  build() {
    for (const pane of this.panes.values()) pane.plot.destroy();
    this.panes.clear();
    at("panes").replaceChildren();
    const units = new Map();
    for (const name of this.shown) {
      const unit = this.placed.get(name) ?? this.unit(name);
      units.set(unit, [...(units.get(unit) || []), name]);
    }
    for (const [unit, names] of units) {
      const place = pane(unit, names.map((name) => this.style(name)), (name) => this.drop(name, unit));
      at("panes").append(place);
      this.panes.set(unit, { names, plot: this.plot(place, unit, names) });
    }
    this.resize();
    this.dirty();
  }

  plot(place, unit, names) {
    const hooks = { setSelect: [(plot) => this.zoomTo(plot)], draw: [(plot) => this.overlay(plot, names)], ready: [(plot) => this.listen(plot)] };
    const width = Math.max(200, at("panes").clientWidth - 12);
    const series = names.map((name) => this.style(name));
    const how = options({ unit, series, width, height: 200, xLabel: "time [s]", sync: "scope", drag: { setScale: false }, hooks });
    return new uPlot(how, [[], ...names.map(() => [])], place);
  }

  listen(plot) {
    plot.over.addEventListener("dblclick", () => this.pause(false));
    plot.over.addEventListener("click", (event) => {
      if (!at("cursors").checked) return;
      const t = plot.posToVal(event.offsetX, "x");
      this.marks = [...this.marks, t].slice(-2);
      this.dirty();
    });
    plot.over.addEventListener("wheel", (event) => {
      if (this.paused === null) return;
      event.preventDefault();
      this.move(0, event.deltaY > 0 ? 1.25 : 0.8, plot.posToVal(event.offsetX, "x"));
    }, { passive: false });
  }

  zoomTo(plot) {
    const { left, width } = plot.select;
    if (width < 6) return;
    const view = { from: plot.posToVal(left, "x"), to: plot.posToVal(left + width, "x") };
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.pause(true);
    this.paused = view;
    this.dirty();
  }

  pause(stands) {
    this.paused = stands ? this.view() : null;
    if (!stands) this.caught = null;
    at("pause").textContent = stands ? "Go on" : "Pause";
    at("pause").className = stands ? "on" : "";
    this.dirty();
  }

  move(by, factor, about) {
    if (this.paused === null) this.pause(true);
    const { from, to } = this.paused;
    const middle = about === undefined ? 0.5 * (from + to) : about;
    const shift = by * (to - from);
    this.paused = { from: middle + (from - middle) * factor + shift, to: middle + (to - middle) * factor + shift };
    this.dirty();
  }

  view() {
    if (!this.ring || !this.ring.end) return { from: 0, to: this.span };
    const newest = this.ring.newest;
    const span = this.span;
    const free = { from: Math.max(newest - span, Math.min(0, newest)), to: Math.max(newest, span) };
    if (!at("trigger-channel").value) return free;
    const found = this.find(newest, span);
    if (found !== null) {
      this.caught = { from: found - BEFORE * span, to: found + (1 - BEFORE) * span, at: found };
      if (at("trigger-mode").value === "single" && this.paused === null) {
        this.paused = this.caught;
        at("pause").textContent = "Go on";
        at("pause").className = "on";
      }
    }
    return this.caught || (at("trigger-mode").value === "auto" ? free : { from: 0, to: span });
  }

  // Time of the newest crossing whose view is complete, or null.
  find(newest, span) {
    const { ring } = this;
    const column = ring.names.indexOf(at("trigger-channel").value);
    const level = Number(at("trigger-level").value) / this.scale(at("trigger-channel").value);
    const sign = at("trigger-edge").value === "rising" ? 1 : -1;
    const from = ring.row(Math.max(ring.oldest, newest - 2 * span));
    for (let row = ring.row(newest - (1 - BEFORE) * span); row > from; row -= 1) {
      const [before, after] = [ring.at(row - 1, column) - level, ring.at(row, column) - level];
      if (sign * before < 0 && sign * after >= 0) {
        const [t0, t1] = [ring.at(row - 1, ring.time), ring.at(row, ring.time)];
        return t0 + ((t1 - t0) * before) / (before - after);
      }
    }
    return null;
  }

  overlay(plot, names) {
    const { ctx } = plot;
    const { left, top, width, height } = plot.bbox;
    ctx.save();
    ctx.strokeStyle = "#16202a";
    ctx.fillStyle = "#16202a";
    ctx.font = `600 ${12 * devicePixelRatio}px system-ui`;
    this.marks.forEach((t, index) => {
      const x = plot.valToPos(t, "x", true);
      if (x < left || x > left + width) return;
      ctx.beginPath();
      ctx.moveTo(x, top);
      ctx.lineTo(x, top + height);
      ctx.stroke();
      ctx.fillText("AB"[index], x + 4, top + 12 * devicePixelRatio);
    });
    if (names.includes(at("trigger-channel").value)) {
      const y = plot.valToPos(Number(at("trigger-level").value), scaleOf(this.unit(at("trigger-channel").value)), true);
      ctx.setLineDash([4, 4]);
      ctx.beginPath();
      ctx.moveTo(left, y);
      ctx.lineTo(left + width, y);
      ctx.stroke();
    }
    ctx.restore();
  }

  visible(is) {
    this.isVisible = is;
    if (is) {
      this.resize();
      this.dirty();
    }
  }

  resize() {
    const width = at("panes").clientWidth - 12;
    if (width < 50 || !this.panes.size) return;
    const room = window.innerHeight - 420;
    const height = Math.max(150, Math.min(340, room / this.panes.size));
    for (const { plot } of this.panes.values()) {
      if (plot.width !== width || plot.height !== height) plot.setSize({ width, height });
    }
  }

  dirty() {
    this.drawnEnd = -1;
    this.lastRead = 0;
  }

  draw() {
    if (!this.isVisible || !this.ring) return;
    this.note();
    if (this.drawnEnd === this.ring.end) return;
    if (this.paused !== null && this.drawnEnd >= 0) return;
    this.drawnEnd = this.ring.end;
    const view = this.paused || this.view();
    const from = Math.max(this.ring.begin, this.ring.row(view.from) - 1);
    const to = Math.min(this.ring.end, this.ring.row(view.to) + 1);
    const time = this.ring.column("time", from, to);
    for (const { names, plot } of this.panes.values()) {
      plot.batch(() => {
        plot.setData([time, ...names.map((name) => drawable(this.shownColumn(name, from, to)))], false);
        plot.setScale("x", { min: view.from, max: view.to });
      });
    }
    if (performance.now() - this.lastRead > READ_MS) {
      this.lastRead = performance.now();
      this.read(time, from, to);
    }
  }

  shownColumn(name, from, to) {
    const [scale, column] = [this.scale(name), this.ring.column(name, from, to)];
    return scale === 1 ? column : column.map((value) => scale * value);
  }

  read(time, from, to) {
    const two = this.marks.length === 2;
    const heads = ["channel", "unit", "now", "min", "max", "mean", "amplitude", "rms", "frequency [Hz]"];
    if (this.marks.length) heads.push(...(two ? ["at A", "at B", "B − A"] : ["at A"]));
    const rows = this.shown.map((name) => {
      const found = measure(time, this.shownColumn(name, from, to));
      const cells = found ? [found.now, found.low, found.high, found.mean, found.amplitude, found.rms, found.frequency] : Array(7).fill(NaN);
      const keys = ["now", "min", "max", "mean", "amplitude", "rms", "frequency"];
      const marked = this.marks.map((t) => {
        const row = Math.min(this.ring.row(t), this.ring.end - 1);
        return this.scale(name) * this.ring.at(row, this.ring.names.indexOf(name));
      });
      if (two) marked.push(marked[1] - marked[0]);
      return element(
        "tr",
        { "data-channel": name },
        element("td", {}, swatch(this.style(name)), name),
        element("td", { class: "text dim" }, this.unit(name)),
        ...cells.map((cell, index) => element("td", { "data-what": keys[index], "data-value": String(cell) }, number(cell))),
        ...marked.map((cell) => element("td", {}, number(cell))),
      );
    });
    at("readout").replaceChildren(
      element("thead", {}, element("tr", {}, ...heads.map((head) => element("th", { class: head === "unit" ? "text" : "" }, head)))),
      element("tbody", {}, ...rows),
    );
  }

  note() {
    const parts = [];
    if (!this.ring) parts.push("Rows appear here as soon as the machine is connected, or a run records.");
    else {
      const own = this.recording && this.recording.name === this.name ? this.recording : null;
      if (!own) parts.push("live: nothing is recorded");
      else if (!own.began) parts.push(`${this.name}: not begun yet; the machine goes to its start`);
      else parts.push(`${this.name}: recording began at ${own.began}, ${this.ring.end} rows`);
      if (own && !own.live) parts.push("ended");
      if (this.lost) parts.push(`${this.lost} rows did not reach this page: it is too slow for them`);
      if (this.paused) parts.push("the view stands still; rows go on coming. Double-click to go on");
      if (this.marks.length === 2) {
        const step = this.marks[1] - this.marks[0];
        parts.push(`B − A = ${number(step, 5)} s, 1 / (B − A) = ${number(1 / step, 5)} Hz`);
      } else if (at("cursors").checked) parts.push("click into a pane to place a cursor");
      else parts.push("drag to zoom");
    }
    const text = parts.join(" · ");
    if (text !== this.info) {
      this.info = text;
      at("scope-note").textContent = text;
    }
  }
}
