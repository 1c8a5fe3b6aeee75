// Puts a live figure in place of the plain one.
function mount(figure, number) {
  const chart = JSON.parse(figure.querySelector("script").textContent);
  const state = { off: [], seeds: [], zoom: null }, box = document.createElement("div");
  const button = (kind, value, words, mark = "") =>
    `<button type="button" data-${kind}="${Report.escaped(value)}">${mark}${Report.escaped(words)}</button>`;
  const swatch = (part) => `<i style="--pen:${part.color};--style:${part.dash ? (part.dash[0] === "2" ? "dotted" : "dashed") : "solid"}"${part.width ? "" : ' class="area"'}></i>`;
  const names = Report.legend(chart).map((part) => button("name", part.name, part.name, swatch(part))).join("");
  const notes = [...new Set(chart.panels.flatMap((panel) => panel.notes))];
  const single = Report.seeds(chart).map((seed) => button("seed", seed, Report.place(seed))).join("");
  box.className = "chart";
  box.innerHTML = `<p class="name">${Report.escaped(chart.title)}</p><div class="tools">${names}`
    + (single ? `<span>compare single seeds:</span>${single}` : "")
    + `<span class="zoom">${button("zoom", "0.5", "+")}${button("zoom", "2", "−")}${button("zoom", "0", "whole")}</span></div>`
    + (notes.length ? `<p class="notes">${notes.map(Report.escaped).join("; ")}</p>` : "")
    + '<div class="host" tabindex="0"></div><div class="tip" hidden></div>';
  const host = box.querySelector(".host"), tip = box.querySelector(".tip");
  let places = [], from = null, at = null;
  const draw = () => {
    const width = Math.max(280, box.clientWidth || 760);
    ({ places } = Report.layout(chart, state, width));
    host.innerHTML = Report.render(chart, state, width, `f${number}`);
    for (const one of box.querySelectorAll("button")) {
      const { name, seed } = one.dataset;
      if (name) one.setAttribute("aria-pressed", !state.off.includes(name));
      if (seed) one.setAttribute("aria-pressed", state.seeds.includes(Number(seed)));
    }
    tip.hidden = true;
  };
  const switched = (list, value) => list.includes(value) ? list.filter((one) => one !== value) : [...list, value];
  const zoom = (factor, middle) => {
    const [low, high] = places[0].range, [least, most] = chart.panels[0].x, half = (high - low) * factor / 2;
    const centre = middle ?? (low + high) / 2, next = [Math.max(least, centre - half), Math.min(most, centre + half)];
    state.zoom = !factor || next[1] - next[0] >= most - least ? null : next;
    draw();
  };
  box.addEventListener("click", ({ target }) => {
    const { name, seed, zoom: factor } = target.closest("button")?.dataset || {};
    if (factor) return zoom(Number(factor));
    if (name) state.off = switched(state.off, name);
    if (seed) state.seeds = switched(state.seeds, Number(seed));
    if (name || seed) draw();
  });
  const read = (place, x, end) => {
    at = x;
    const here = Report.values(place.panel, state, x), unit = / \[(.*)\]$/.exec(place.panel.ylabel)?.[1] || "";
    const axis = (places.at(-1).panel.xlabel || "time [s]").replace(/ \[.*\]$/, "");
    tip.innerHTML = `<b>${Report.escaped(axis)} ${Report.written(here[0]?.x ?? x)}</b>` + here.map((v) =>
      `<span><i style="--pen:${v.color}"></i>${Report.escaped(v.name)}: ${v.y === null ? "none" : Report.written(v.y)} ${unit === "-" ? "" : Report.escaped(unit)}</span>`).join("");
    tip.hidden = !here.length;
    const left = host.offsetLeft + place.x.of(x);
    tip.style.left = `${Math.max(0, Math.min(left + 12, box.clientWidth - tip.offsetWidth - 4))}px`;
    tip.style.top = `${host.offsetTop + place.box.bottom + 4}px`;
    const near = end === undefined && here[0] ? here[0].x : x;
    const lines = places.map((p) => `<path d="M${p.x.of(near)} ${p.box.top}V${p.box.bottom}"/>`).join("");
    const area = end === undefined ? "" : places.map((p) =>
      `<rect x="${Math.min(p.x.of(x), p.x.of(end))}" y="${p.box.top}" width="${Math.abs(p.x.of(x) - p.x.of(end))}" height="${p.box.bottom - p.box.top}"/>`).join("");
    host.querySelector(".cross").innerHTML = lines + area;
  };
  const found = (event) => {
    const frame = host.getBoundingClientRect(), px = event.clientX - frame.left, py = event.clientY - frame.top;
    const place = places.filter((p) => px >= p.box.left - 30 && px <= p.box.right + 30)
      .sort((a, b) => Math.abs((a.box.top + a.box.bottom) / 2 - py) - Math.abs((b.box.top + b.box.bottom) / 2 - py))[0];
    return place && [place, place.x.back(Math.max(place.box.left, Math.min(place.box.right, px)))];
  };
  host.addEventListener("pointerdown", (event) => { from = event.pointerType === "mouse" ? found(event)?.[1] ?? null : null; });
  host.addEventListener("pointermove", (event) => { const hit = found(event); if (hit) read(...hit, from ?? undefined); });
  host.addEventListener("pointerup", (event) => {
    const to = found(event)?.[1], begun = from;
    from = null;
    if (begun === null || to === undefined) return;
    if (Math.abs(places[0].x.of(begun) - places[0].x.of(to)) > 8) zoom(Math.abs(to - begun) / (places[0].range[1] - places[0].range[0]), (begun + to) / 2);
  });
  host.addEventListener("pointerleave", () => { from = null; tip.hidden = true; host.querySelector(".cross").innerHTML = ""; });
  host.addEventListener("dblclick", () => zoom(0));
  host.addEventListener("keydown", (event) => {
    const [low, high] = places[0].range, step = { ArrowLeft: -0.01, ArrowRight: 0.01 }[event.key];
    if (step) read(places[0], Math.max(low, Math.min(high, (at ?? low) + step * (high - low))));
    else if ("+-0".includes(event.key)) zoom({ "+": 0.5, "-": 2, 0: 0 }[event.key], at ?? undefined);
    else return;
    event.preventDefault();
  });
  figure.classList.add("live");
  figure.append(box);
  figure.append(figure.querySelector("figcaption"));
  draw();
  return draw;
}

// Dark or light as chosen before, else as the system has it; the section that is read is marked in the contents.
function begin() {
  const root = document.documentElement, kept = (() => { try { return localStorage; } catch { return {}; } })();
  const dark = () => (root.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  if (kept.theme) root.dataset.theme = kept.theme;
  document.addEventListener("DOMContentLoaded", () => {
    // A figure comes to life when it comes near, as many of them at once would keep a phone busy.
    const draws = [], seen = new IntersectionObserver((entries) => {
      for (const { target } of entries.filter((entry) => entry.isIntersecting)) {
        seen.unobserve(target);
        draws.push(mount(target, draws.length));
      }
    }, { rootMargin: "600px" });
    for (const one of document.querySelectorAll("figure")) if (one.querySelector("script")) seen.observe(one);
    document.querySelector("#theme").addEventListener("click", () => { root.dataset.theme = kept.theme = dark() ? "light" : "dark"; });
    const links = [...document.querySelectorAll("nav a")], sections = [...document.querySelectorAll("section")];
    const mark = () => {
      const here = sections.filter((one) => one.getBoundingClientRect().top < 140).pop() || sections[0];
      for (const link of links) link.toggleAttribute("aria-current", link.hash === `#${here.id}`);
    };
    document.querySelector("nav").addEventListener("click", () => { document.querySelector("#menu").checked = false; });
    addEventListener("scroll", mark, { passive: true });
    let width = innerWidth;
    addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; draws.forEach((draw) => draw()); } });
    mark();
  });
}
begin();
