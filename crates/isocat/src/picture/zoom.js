"use strict";
// Drawings along time: zoom and pan by buttons, keys, the wheel and the mouse. What is in the group "stretch" is stretched, words stay
// as they are. Reports and the playground have it from here.
globalThis.isocatZoom = (() => {
  /** A time in ns with the unit that suits it, to the picosecond below a ms. */
  function time(ns, step = 0) {
    const size = Math.max(Math.abs(ns), step);
    const [value, unit] = size < 1e3 ? [ns, "ns"] : size < 1e6 ? [ns / 1e3, "us"] : size < 1e9 ? [ns / 1e6, "ms"] : [ns / 1e9, "s"];
    const digits = unit === "ns" || unit === "us" ? 3 : unit === "ms" ? 6 : 9;
    return `${Number(value.toFixed(digits))} ${unit}`;
  }
  const exact = (ns) => `${ns.toLocaleString("en", { maximumFractionDigits: 3 }).replaceAll(",", "\u202f")} ns`;
  /** No more digits than a pixel has. */
  const rough = (ns, unit) => exact(Math.round(ns / 10 ** Math.floor(Math.log10(unit))) * 10 ** Math.floor(Math.log10(unit)));
  /** The next of 1, 2, 5, 10 ... that is not less. */
  function step(least) {
    const ten = 10 ** Math.floor(Math.log10(least));
    return [1, 2, 5, 10].map((f) => f * ten).find((s) => s >= least * 0.999999) ?? 10 * ten;
  }

  /** One drawing along time. */
  class Zoom {
    constructor(svg) {
      this.svg = svg;
      const number = (name) => Number(svg.dataset[name]);
      [this.first, this.last] = [number("from"), number("to")];
      [this.left, this.right, this.bottom] = [number("left"), number("right"), number("bottom")];
      [this.from, this.to] = [this.first, this.last];
      this.stretch = svg.querySelector("g.stretch");
      this.axis = svg.querySelector("g.axis");
      this.texts = [...svg.querySelectorAll("text.moves")].map((text) => {
        const x = Number(text.getAttribute("x"));
        return { text, x, ends: text.dataset.ends?.split(" ").map(Number) };
      });
      this.tools();
      svg.tabIndex = 0;
      svg.addEventListener("keydown", (event) => this.key(event));
      svg.addEventListener("pointerleave", () => { this.output.textContent = ""; });
      svg.addEventListener("dblclick", () => this.see(this.first, this.last));
      svg.addEventListener("pointerdown", (event) => this.select(event));
      svg.addEventListener("pointermove", (event) => this.tell(event));
      svg.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && !event.metaKey) return;
        event.preventDefault();
        this.zoom(event.deltaY < 0 ? 1.3 : 1 / 1.3, this.time(event.clientX));
      }, { passive: false });
    }
    tools() {
      const bar = document.createElement("div");
      bar.className = "tools";
      const button = (text, label, action) => {
        const made = document.createElement("button");
        made.type = "button";
        made.textContent = text;
        made.setAttribute("aria-label", `${label}: ${this.svg.getAttribute("aria-label")}`);
        made.addEventListener("click", action);
        bar.append(made);
      };
      button("+", "zoom in", () => this.zoom(2));
      button("\u2212", "zoom out", () => this.zoom(0.5));
      button("\u2190", "earlier", () => this.pan(-0.3));
      button("\u2192", "later", () => this.pan(0.3));
      button("all", "whole", () => this.see(this.first, this.last));
      this.output = document.createElement("output");
      bar.append(this.output);
      this.svg.closest("figure").prepend(bar);
    }
    /** Time at a place of the window. */
    time(clientX) {
      const box = this.svg.getBoundingClientRect();
      const x = (clientX - box.left) / box.width * this.svg.viewBox.baseVal.width;
      return this.from + (x - this.left) / (this.right - this.left) * (this.to - this.from);
    }
    x(ns) {
      return this.left + (ns - this.from) / (this.to - this.from) * (this.right - this.left);
    }
    see(from, to) {
      const most = this.last - this.first;
      // Nothing happens between two picoseconds.
      const span = Math.min(Math.max(to - from, 0.01), most);
      from = Math.max(this.first, Math.min(from, this.last - span));
      [this.from, this.to] = [from, from + span];
      const k = most / span;
      const shift = this.left * (1 - k) + (this.first - from) / span * (this.right - this.left);
      this.stretch.setAttribute("transform", `translate(${shift} 0) scale(${k} 1)`);
      for (const { text, x, ends } of this.texts) {
        let place = shift + k * x;
        if (ends && k > 1) {
          // Words of a distance stay in the middle of what is seen of it.
          const [a, b] = ends.map((end) => Math.max(this.left, Math.min(shift + k * end, this.right)));
          place = b > a ? Math.max(this.left + 2, Math.min((a + b) / 2 - text.getComputedTextLength() / 2, this.right - text.getComputedTextLength())) : -1;
        }
        text.setAttribute("x", k === 1 ? x : place);
        text.style.display = k > 1 && (place < this.left - 2 || place > this.right - 12) ? "none" : "";
      }
      this.ticks();
    }
    ticks() {
      const unit = step((this.to - this.from) / 7);
      let marks = "";
      for (let n = Math.ceil(this.from / unit); n * unit <= this.to; n += 1) {
        const x = this.x(n * unit).toFixed(2);
        const words = time(n * unit);
        // Half of the words stand to the right of their tick.
        const width = this.svg.viewBox.baseVal.width;
        const [place, anchor] = Number(x) + words.length * 3.05 > width ? [width, "end"] : [x, "middle"];
        marks += `<line class="grid" x1="${x}" y1="4" x2="${x}" y2="${this.bottom}"/><text class="tick" x="${place}" y="${this.bottom + 16}" text-anchor="${anchor}">${words}</text>`;
      }
      this.axis.innerHTML = marks;
    }
    zoom(factor, around = (this.from + this.to) / 2) {
      this.see(around - (around - this.from) / factor, around + (this.to - around) / factor);
    }
    pan(part) {
      const by = (this.to - this.from) * part;
      this.see(this.from + by, this.to + by);
    }
    key(event) {
      const actions = {
        "+": () => this.zoom(2), "=": () => this.zoom(2), "-": () => this.zoom(0.5), "0": () => this.see(this.first, this.last),
        ArrowLeft: () => this.pan(-0.2), ArrowRight: () => this.pan(0.2),
      };
      const action = event.ctrlKey || event.metaKey || event.altKey ? undefined : actions[event.key];
      if (!action) return;
      event.preventDefault();
      event.stopPropagation();
      action();
    }
    /** Says which instant is pointed at. */
    tell(event) {
      const at = this.time(event.clientX);
      if (at < this.from || at > this.to) return;
      this.output.textContent = `at ${rough(at, (this.to - this.from) / 900)}`;
    }
    select(event) {
      if (event.button !== 0 || event.pointerType === "touch") return;
      const begin = this.time(event.clientX);
      if (begin < this.from || begin > this.to) return;
      const box = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      box.setAttribute("class", "selection");
      box.setAttribute("y", 4);
      box.setAttribute("height", this.bottom - 4);
      const move = (event) => {
        const ends = [begin, this.time(event.clientX)].sort((a, b) => a - b);
        const [a, b] = ends.map((ns) => Math.max(this.left, Math.min(this.x(ns), this.right)));
        box.setAttribute("x", a);
        box.setAttribute("width", b - a);
        if (b - a > 4 && !box.isConnected) this.svg.append(box);
        return [...ends, b - a];
      };
      const end = (event) => {
        removeEventListener("pointermove", move);
        const [from, to, width] = move(event);
        box.remove();
        if (width > 4) this.see(from, to);
      };
      addEventListener("pointermove", move);
      addEventListener("pointerup", end, { once: true });
      event.preventDefault();
      this.svg.focus({ preventScroll: true });
    }
  }
  return { Zoom, time, exact };
})();
