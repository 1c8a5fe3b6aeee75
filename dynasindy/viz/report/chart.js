"use strict";
// Draws the figures of a report again from their numbers: zoom, read-out of values, series and seeds to switch.
// `render` returns text and touches no document, so that it runs anywhere; `mount` puts it into a page.
const Report = (() => {
  const LEFT = 64, RIGHT = 10, TOP = 20, FOOT = 36, NARROW = 640, LETTER = 6.2, LINE = 14;
  const escaped = (words) => String(words).replace(/[&<>"']/g, (sign) => `&#${sign.charCodeAt(0)};`);
  // A symbol with its index lowered: α_a.
  const symbols = (words) => escaped(words).replace(/(^| )(\S)_(\w+)/g, '$1$2<tspan dy="3" font-size="9">$3</tspan><tspan dy="-3">\u200b</tspan>');
  const numbers = (x) => Array.isArray(x) ? x : Array.from({ length: x.count }, (_, k) => x.first + k * x.step);
  const short = (value) => Number(value.toFixed(1));

  // A scale leads from values to pixels, `of`, and back, `back`.
  function scale(kind, [low, high], [start, end], linear = 10) {
    const bend = 1 / 0.9, size = (v) => Math.abs(v) / linear;
    const forms = {
      linear: [(v) => v, (t) => t],
      log: [(v) => Math.log10(Math.max(v, 1e-300)), (t) => 10 ** t],
      symlog: [
        (v) => Math.sign(v) * (size(v) <= 1 ? size(v) * bend : bend + Math.log10(size(v))),
        (t) => Math.sign(t) * linear * (Math.abs(t) <= bend ? Math.abs(t) / bend : 10 ** (Math.abs(t) - bend)),
      ],
    };
    const [form, inverse] = forms[kind], a = form(low), b = form(high);
    const wide = b - a || 1;
    return {
      of: (v) => start + (form(v) - a) / wide * (end - start),
      back: (p) => inverse(a + (p - start) / (end - start) * wide),
    };
  }

  function ticks(kind, low, high, most, linear = 10) {
    if (kind !== "linear") {
      const decades = [];
      for (let k = -300; k <= 300; k++) {
        if (kind === "log" || 10 ** k >= linear * 0.999) decades.push(10 ** k);
      }
      const all = kind === "log" ? decades : [...decades.map((v) => -v).reverse(), 0, ...decades];
      const seen = all.filter((v) => v >= low * (low < 0 ? 1.001 : 0.999) && v <= high * (high > 0 ? 1.001 : 0.999));
      const every = Math.ceil(seen.length / most), zero = Math.max(0, seen.indexOf(0));
      if (seen.length > 1) return seen.filter((_, k) => (k - zero) % every === 0);
    }
    const raw = (high - low) / most || 1, ten = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((m) => m * ten).find((s) => s >= raw * 0.999);
    const first = Math.ceil(low / step - 1e-9), count = Math.floor(high / step + 1e-9) - first + 1;
    return Array.from({ length: Math.max(0, count) }, (_, k) => Number(((first + k) * step).toPrecision(12)));
  }

  function written(value, digits = 4) {
    if (!Number.isFinite(value)) return "none";
    const size = Math.abs(value);
    if (size && (size < 1e-3 || size >= 1e5)) {
      const power = Math.floor(Math.log10(size) + 1e-9), front = Number((value / 10 ** power).toPrecision(digits));
      const high = String(power).replace(/[-\d]/g, (sign) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(sign)]);
      return `${value < 0 ? "−" : ""}${Math.abs(front) === 1 ? "" : `${Math.abs(front)}·`}10${high}`;
    }
    return String(Number(value.toPrecision(digits))).replace("-", "−");
  }

  // Every name of a figure once, with what its entry in the legend looks like.
  function legend(chart) {
    const found = new Map();
    for (const panel of chart.panels) {
      for (const part of [...panel.lines, ...panel.bands, ...panel.spans]) {
        if (part.name && !found.has(part.name)) found.set(part.name, part);
      }
    }
    return [...found.values()];
  }
  const place = (number) => `${number}${["st", "nd", "rd"][number - 1] || "th"}`; // seeds stand in the order of the table
  const seeds = (chart) => [...new Set(chart.panels.flatMap((panel) => panel.lines.map((line) => line.seed)))]
    .filter(Boolean).sort((a, b) => a - b);
  const shown = (part, state) => !state.off.includes(part.name) && (!part.seed || state.seeds.includes(part.seed));

  // Limits of y: those of the figure, wider where a seed needs it, and what is in sight where x is zoomed.
  function limits(panel, state) {
    const [low, high, kind] = panel.y;
    const lines = panel.lines.filter((line) => line.y && shown(line, state) && (state.zoom || line.seed));
    const seen = lines.flatMap((line) => {
      const x = numbers(line.x), inside = (v) => !state.zoom || (v >= state.zoom[0] && v <= state.zoom[1]);
      return numbers(line.y).filter((v, k) => v !== null && inside(x[k]) && (kind !== "log" || v > 0));
    });
    if (!seen.length) return [low, high];
    const least = seen.reduce((a, b) => Math.min(a, b)), most = seen.reduce((a, b) => Math.max(a, b));
    if (!state.zoom) return [Math.min(low, least), Math.max(high, most)];
    const axis = scale(kind, [least, most], [0, 1], panel.linear);
    return most > least ? [axis.back(-0.08), axis.back(1.08)] : [least - (Math.abs(least) || 1) * 0.1, most + (Math.abs(most) || 1) * 0.1];
  }

  // Whether a panel's title finds no room behind the label, and stands below it.
  const below = (panel, wide) => Boolean(panel.title) && (panel.ylabel.length + 1 + panel.title.length) * LETTER > wide;

  // Where each panel lies and its scales; one column on a narrow page.
  function layout(chart, state, width) {
    const columns = width < NARROW ? 1 : chart.columns, height = chart.panels.length === 1 ? 250 : 130;
    const shared = chart.panels.every((panel) => panel.x[0] === chart.panels[0].x[0] && panel.x[1] === chart.panels[0].x[1]);
    let top = 0;
    const rows = Math.ceil(chart.panels.length / columns), cell = width / columns, places = [];
    for (let row = 0; row < rows; row++) {
      const foot = shared && row < rows - 1 ? 6 : FOOT, all = chart.panels.slice(row * columns, (row + 1) * columns);
      const head = TOP + (all.some((panel) => below(panel, cell)) ? LINE : 0);
      for (let column = 0; column < columns && row * columns + column < chart.panels.length; column++) {
        const panel = chart.panels[row * columns + column], left = column * cell + LEFT;
        const box = { left, right: (column + 1) * cell - RIGHT, top: top + head, bottom: top + head + height };
        const range = (shared && state.zoom) || panel.x.slice(0, 2), y = limits(panel, shared ? state : { ...state, zoom: null });
        places.push({
          panel, box, foot: foot === FOOT, two: below(panel, cell), range, limits: y,
          x: scale(panel.x[2], range, [box.left, box.right], panel.linear),
          y: scale(panel.y[2], y, [box.bottom, box.top], panel.linear),
        });
      }
      top += head + height + foot;
    }
    return { places, height: top };
  }

  function outline(place, part) {
    const x = numbers(part.x), y = numbers(part.y);
    let path = "", pen = false, before = 0;
    x.forEach((value, k) => {
      if (value === null || y[k] === null) { pen = false; return; }
      const [px, py] = [place.x.of(value), Math.max(-1e4, Math.min(1e4, place.y.of(y[k])))].map(short);
      path += !pen ? `M${px} ${py}` : part.step ? `H${px}V${py}` : `L${px} ${py}`;
      pen = true; before = py;
    });
    return path;
  }

  function drawn(place, part) {
    const { box } = place, pen = `stroke="${part.color}" stroke-width="${part.width}" stroke-dasharray="${part.dash || ""}"`;
    if ("level" in part) return `<path d="M${box.left} ${short(place.y.of(part.level))}H${box.right}" ${pen}/>`;
    if ("at" in part) return `<path d="M${short(place.x.of(part.at))} ${box.top}V${box.bottom}" ${pen}/>`;
    const line = part.dash === null ? "" : `<path d="${outline(place, part)}" ${pen} opacity="${part.alpha ?? 1}"/>`;
    if (!part.dot) return line;
    const x = numbers(part.x), paint = part.ring ? `fill="none" stroke="${part.color}"` : `fill="${part.color}"`;
    return line + numbers(part.y).map((v, k) => v === null ? ""
      : `<circle cx="${short(place.x.of(x[k]))}" cy="${short(place.y.of(v))}" r="${part.dot}" ${paint}/>`).join("");
  }

  function panelText(place, number, id, state) {
    const { panel, box } = place, clip = `${id}-clip-${number}`, edge = state.zoom ? 0 : 4;
    const xs = ticks(panel.x[2], ...place.range, Math.max(3, Math.floor((box.right - box.left) / 70)), panel.linear);
    const ys = ticks(panel.y[2], ...place.limits, panel.y[2] === "linear" ? 5 : 7, panel.linear);
    const grid = xs.map((v) => `M${short(place.x.of(v))} ${box.top}V${box.bottom}`)
      .concat(ys.map((v) => `M${box.left} ${short(place.y.of(v))}H${box.right}`)).join("");
    const spans = panel.spans.filter((part) => shown(part, state)).map((part) => {
      const [a, b] = (part.x || place.range).map(place.x.of), [c, d] = (part.y || place.limits).map(place.y.of);
      return `<rect x="${short(Math.min(a, b))}" y="${short(Math.min(c, d))}" width="${short(Math.abs(b - a))}" height="${short(Math.abs(d - c))}" fill="${part.color}" opacity="${part.alpha}"/>`;
    });
    const bands = panel.bands.filter((part) => shown(part, state))
      .map((part) => `<path d="${outline(place, part)}Z" fill="${part.color}" opacity="${part.alpha}"/>`);
    const lines = panel.lines.filter((part) => shown(part, state)).map((part) => drawn(place, part));
    const at = `x="${(box.left + box.right) / 2}" text-anchor="middle"`;
    return `<clipPath id="${clip}"><rect x="${box.left - edge}" y="${box.top - 4}" width="${box.right - box.left + 2 * edge}" height="${box.bottom - box.top + 8}"/></clipPath>`
      + `<path class="grid" d="${grid}"/><g clip-path="url(#${clip})">${spans.join("")}${bands.join("")}${lines.join("")}</g>`
      + `<path class="frame" d="M${box.left} ${box.top}V${box.bottom}H${box.right}"/>`
      + (place.foot ? xs.map((v) => `<text x="${short(place.x.of(v))}" y="${box.bottom + 14}" text-anchor="middle">${written(v)}</text>`).join("")
        + `<text ${at} y="${box.bottom + 30}">${escaped(panel.xlabel || "time [s]")}</text>` : "")
      + ys.map((v) => `<text x="${box.left - 5}" y="${short(place.y.of(v)) + 4}" text-anchor="end">${written(v)}</text>`).join("")
      + `<text class="label" x="${box.left - LEFT + 4}" y="${box.top - 7 - (place.two ? LINE : 0)}">${symbols(panel.ylabel.replace("\n", " "))}`
      + (place.two ? `</text><text class="title" x="${box.left - LEFT + 4}" y="${box.top - 7}">${escaped(panel.title)}</text>`
        : `${panel.title ? ` <tspan class="title">${escaped(panel.title)}</tspan>` : ""}</text>`);
  }

  const START = { off: [], seeds: [], zoom: null };
  function render(chart, state = START, width = 760, id = "chart") {
    const { places, height } = layout(chart, state, width);
    return `<svg viewBox="0 0 ${short(width)} ${height}" width="${short(width)}" height="${height}" role="img" aria-label="${escaped(chart.title)}" fill="none">`
      + places.map((place, number) => panelText(place, number, id, state)).join("") + '<g class="cross"></g></svg>';
  }

  // The values of a panel's lines at x: the nearest sample, or the one that is held.
  function values(panel, state, x) {
    return panel.lines.filter((line) => line.y && shown(line, state)).map((line) => {
      const all = numbers(line.x);
      let best = 0;
      all.forEach((v, k) => { if (line.step ? v <= x : Math.abs(v - x) < Math.abs(all[best] - x)) best = k; });
      const seed = line.seed ? `, ${place(line.seed)} seed` : "";
      return { name: (line.name || "value") + seed, color: line.color, x: all[best], y: numbers(line.y)[best] };
    });
  }
  return { scale, ticks, written, legend, place, seeds, limits, layout, render, values, escaped, START };
})();
if (typeof module !== "undefined") module.exports = Report;
