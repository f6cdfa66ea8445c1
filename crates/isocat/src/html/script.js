"use strict";
// Zoom, figures at the pointer, hiding of devices, light and dark. The page says everything without it.
(() => {
  const root = document.documentElement;
  root.classList.add("scripted");
  const tip = document.getElementById("tip");

  const { Zoom, time, exact } = globalThis.isocatZoom;

  // Figures at the pointer: titles become texts of our own, which a keyboard and a finger reach, too.
  for (const title of document.querySelectorAll("svg.picture title")) {
    const owner = title.parentElement;
    if (owner.matches("svg")) continue;
    owner.dataset.tip = title.textContent;
    title.remove();
  }
  function show(text, x, y) {
    tip.textContent = text;
    tip.hidden = false;
    const box = tip.getBoundingClientRect();
    tip.style.left = `${Math.max(6, Math.min(x + 14, innerWidth - box.width - 6))}px`;
    tip.style.top = `${y + 18 + box.height > innerHeight ? Math.max(6, y - box.height - 12) : y + 18}px`;
  }
  const hide = () => { tip.hidden = true; };
  document.addEventListener("pointermove", (event) => {
    const owner = event.target instanceof Element && event.target.closest("[data-tip]");
    if (owner) show(owner.dataset.tip, event.clientX, event.clientY);
    else if (!(event.target instanceof Element && event.target.closest("svg[data-series]"))) hide();
  });
  document.addEventListener("pointerleave", hide);
  addEventListener("scroll", hide, { passive: true });

  /** One drawing along time, with its figures. */
  class View extends Zoom {
    constructor(svg) {
      super(svg);
      this.tips = [...svg.querySelectorAll("[data-tip]")];
      this.at = -1;
      this.series = (svg.dataset.series ?? "").split(" ").filter(Boolean).map((span) => span.split(",").map(Number));
      svg.addEventListener("blur", hide);
      svg.addEventListener("pointerleave", hide);
    }
    key(event) {
      super.key(event);
      const by = { n: 1, p: -1 }[event.key];
      if (event.key === "Escape") hide();
      else if (by && !event.ctrlKey && !event.metaKey && !event.altKey) this.next(by);
    }
    /** The next thing with figures. */
    next(by) {
      if (!this.tips.length) return;
      this.at = (this.at + by + this.tips.length) % this.tips.length;
      const owner = this.tips[this.at];
      const box = owner.getBoundingClientRect();
      show(owner.dataset.tip, box.left + box.width / 2, box.top + box.height / 2);
    }
    tell(event) {
      super.tell(event);
      const at = this.time(event.clientX);
      if (!this.series?.length || at < this.from || at > this.to) return;
      const span = this.series.find(([, end]) => end >= at) ?? this.series.at(-1);
      const [begin, end, least, mean, largest] = span;
      const when = begin === end ? time(begin) : `${time(begin)} to ${time(end)}`;
      const words = `mean ${exact(mean)}, from ${exact(least)} to ${exact(largest)}`;
      this.output.textContent = `${when}: ${words}`;
      if (!(event.target instanceof Element && event.target.closest("[data-tip]"))) show(`${when}\n${words}`, event.clientX, event.clientY);
    }
  }
  for (const svg of document.querySelectorAll("svg.picture[data-from]")) new View(svg);

  // Hiding of devices.
  for (const box of document.querySelectorAll("[data-hides]")) {
    box.addEventListener("change", () => {
      for (const of of document.querySelectorAll(`[data-device="${box.dataset.hides}"]`)) {
        if (!of.contains(box)) of.classList.toggle("hidden", !box.checked);
      }
    });
  }

  // Who goes to something hidden sees it again.
  for (const link of document.querySelectorAll("a[href^='#device-']")) {
    link.addEventListener("click", () => {
      const box = document.querySelector(`[data-hides="${link.getAttribute("href").slice(8)}"]`);
      if (box && !box.checked) box.click();
    });
  }

  // Light and dark.
  const themes = ["auto", "light", "dark"];
  const button = document.createElement("button");
  button.type = "button";
  button.id = "theme";
  let theme = "auto";
  try { theme = themes.find((t) => t === localStorage.getItem("isocat-theme")) ?? "auto"; } catch { /* files may have no storage */ }
  const dress = () => {
    if (theme === "auto") delete root.dataset.theme;
    else root.dataset.theme = theme;
    button.textContent = `colours: ${theme}`;
    try { localStorage.setItem("isocat-theme", theme); } catch { /* so be it */ }
  };
  button.addEventListener("click", () => { theme = themes[(themes.indexOf(theme) + 1) % themes.length]; dress(); });
  document.querySelector("header").append(button);
  dress();

  document.getElementById("save").addEventListener("click", () => {
    const text = JSON.stringify(JSON.parse(document.getElementById("report").textContent), null, 2);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = "report.json";
    link.click();
    URL.revokeObjectURL(link.href);
  });

  // Paper shows everything, not what was zoomed to.
  addEventListener("beforeprint", () => {
    for (const details of document.querySelectorAll("details")) details.open = true;
  });
})();
