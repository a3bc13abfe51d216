// Curves: which are shown, and their plot with a moving cursor.

const COLORS = ["#f0b35c", "#7cc4ff", "#8fd694", "#e88bb4", "#b9a3f5", "#5fd3c6", "#f08a6b",
  "#d9d067", "#9fb4c9", "#c98f5a", "#6f9df0", "#d48fe0"];
const MARGIN = { left: 62, right: 14, top: 10, bottom: 24 };
const LANE_GAP = 14;
const HELD = /^(viseme|expression)\./; // held from key to key, not interpolated

class Curves {
  constructor(config) {
    const times = takeBytes("curve-times");
    this.times = new Float64Array(times.buffer);
    const values = takeBytes("curve-values");
    this.values = new Float32Array(values.buffer); // one channel after another
    this.channels = config.channels;
    this.regions = config.regions;
    this.channels.forEach((channel, i) => {
      channel.values = this.values.subarray(i * this.times.length, (i + 1) * this.times.length);
      channel.isHeld = HELD.test(channel.name);
    });
  }

  get end() { return this.times.length ? this.times[this.times.length - 1] : 0; }

  /** The last frame that is not after a time, rounding apart. */
  frameAt(time) {
    let low = 0, high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= time + INSIDE_FRAME_S) low = middle + 1; else high = middle;
    }
    return Math.max(low - 1, 0);
  }

  /** The frame that is nearest to a time. */
  nearest(time) {
    const i = this.frameAt(time);
    const next = Math.min(i + 1, this.times.length - 1);
    return Math.abs(this.times[next] - time) < Math.abs(this.times[i] - time) ? next : i;
  }
}

function formatValue(value, unit) {
  if (Number.isNaN(value)) return "not set";
  const size = Math.abs(value);
  const digits = unit === "" && size < 10 ? 3 : size < 10 ? 2 : size < 100 ? 1 : 0;
  return value.toFixed(digits).replace("-", "−");
}

function inDegrees(value, unit) {
  if (unit !== "10⁻⁵ rad" || Number.isNaN(value)) return "";
  return ` (${((value * 1e-5 * 180) / Math.PI).toFixed(1).replace("-", "−")}°)`;
}

function niceStep(span, count) {
  const rough = span / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const factor = [1, 2, 5, 10].find((f) => f * power >= rough);
  return factor * power;
}

class Plot {
  constructor(curves, clock) {
    this.curves = curves;
    this.clock = clock;
    this.colors = new Map();
    this.base = element("canvas", { "aria-hidden": "true" });
    this.top = element("canvas", { "aria-hidden": "true" });
    this.hover = element("div", { class: "hover", hidden: true });
    this.box = element("div", {
      class: "plot", role: "slider", tabindex: "0", "aria-label": "Time, on the curves",
      "aria-valuemin": "0",
    }, this.base, this.top, this.hover);
    this.legend = element("ul", { class: "legend", "aria-label": "Curves shown" });
    this.listen();
    new ResizeObserver(() => this.draw()).observe(this.box);
  }

  // which curves

  toggle(channel, isOn) {
    if (isOn && !this.colors.has(channel)) {
      const used = [...this.colors.values()];
      const free = COLORS.find((color) => !used.includes(color));
      this.colors.set(channel, free ?? COLORS[this.colors.size % COLORS.length]);
    }
    if (!isOn) this.colors.delete(channel);
    this.drawLegend();
    this.draw();
    this.onchange?.(channel, isOn, this.colors.get(channel));
  }

  drawLegend() {
    this.readouts = new Map();
    this.legend.replaceChildren(...[...this.colors].map(([channel, color]) => {
      const value = element("output");
      this.readouts.set(channel, value);
      return element("li", {}, element("button", {
        type: "button", style: `--c: ${color}`, title: `Hide ${channel.name}`,
        onclick: () => this.toggle(channel, false),
        onpointerenter: () => { this.strong = channel; this.draw(); },
        onpointerleave: () => { this.strong = null; this.draw(); },
      }, element("i"), channel.name, value, element("small", {}, channel.unit)));
    }));
    if (!this.colors.size) {
      this.legend.append(element("li", { class: "none" }, "Choose channels to plot."));
    }
  }

  // where things are

  get view() { return this.zoom ?? [0, Math.max(this.clock.duration, 1e-3)]; }
  get width() { return Math.max(this.box.clientWidth - MARGIN.left - MARGIN.right, 1); }

  xOf(time) {
    const [from, to] = this.view;
    return MARGIN.left + ((time - from) / (to - from)) * this.width;
  }

  timeAt(x) {
    const [from, to] = this.view;
    const time = from + ((x - MARGIN.left) / this.width) * (to - from);
    return Math.min(Math.max(time, 0), this.clock.duration);
  }

  /** One lane for each scale: FAP units, angles, weights. */
  lanes() {
    const byScale = new Map();
    for (const channel of this.colors.keys()) {
      if (!byScale.has(channel.scale)) byScale.set(channel.scale, []);
      byScale.get(channel.scale).push(channel);
    }
    const height = this.box.clientHeight - MARGIN.top - MARGIN.bottom;
    const each = (height - LANE_GAP * (byScale.size - 1)) / Math.max(byScale.size, 1);
    return [...byScale].map(([scale, channels], i) => {
      let low = 0, high = 0;
      for (const { range } of channels) { low = Math.min(low, range[0]); high = Math.max(high, range[1]); }
      if (high - low < 1e-9) { low -= 0.5; high += 0.5; }
      const pad = (high - low) * 0.06;
      const top = MARGIN.top + i * (each + LANE_GAP);
      return { scale, channels, low: low - pad, high: high + pad, top, height: each };
    });
  }

  // drawing

  draw() {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => { this.isDue = false; this.drawBase(); this.drawCursor(); });
  }

  fit(canvas) {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.box.clientWidth, this.box.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "11px system-ui, sans-serif";
    return pen;
  }

  drawBase() {
    const pen = this.fit(this.base);
    this.drawn = this.lanes();
    this.drawTimeAxis(pen);
    for (const lane of this.drawn) {
      this.drawLane(pen, lane);
      pen.save();
      pen.beginPath();
      pen.rect(MARGIN.left, lane.top - 2, this.width, lane.height + 4);
      pen.clip();
      for (const channel of lane.channels) this.drawCurve(pen, lane, channel);
      pen.restore();
    }
    this.box.setAttribute("aria-valuemax", this.clock.duration.toFixed(3));
  }

  drawTimeAxis(pen) {
    const [from, to] = this.view;
    const bottom = this.box.clientHeight - MARGIN.bottom;
    const step = niceStep(to - from, this.width / 90);
    const digits = Math.max(0, -Math.floor(Math.log10(step)));
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (let k = Math.ceil(from / step - 1e-9); k * step <= to + 1e-9; k++) {
      const x = Math.round(this.xOf(k * step)) + 0.5;
      pen.strokeStyle = "#23262a";
      pen.beginPath(); pen.moveTo(x, MARGIN.top); pen.lineTo(x, bottom); pen.stroke();
      pen.fillStyle = "#8d939b";
      pen.fillText(`${(k * step).toFixed(digits)} s`, x, bottom + 7);
    }
  }

  drawLane(pen, lane) {
    const yOf = (value) => this.yOf(lane, value);
    const step = niceStep(lane.high - lane.low, lane.height / 17);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let k = Math.ceil(lane.low / step); k * step <= lane.high; k++) {
      const y = Math.round(yOf(k * step)) + 0.5;
      pen.strokeStyle = k === 0 ? "#454a51" : "#23262a";
      pen.beginPath(); pen.moveTo(MARGIN.left, y); pen.lineTo(MARGIN.left + this.width, y); pen.stroke();
      pen.fillStyle = "#8d939b";
      const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      const tick = step >= 5000 ? `${(k * step) / 1000}k`.replace(/^0k$/, "0") : (k * step).toFixed(digits);
      pen.fillText(tick.replace("-", "−"), MARGIN.left - 8, y);
    }
    if (!lane.scale) return;
    pen.save();
    pen.translate(10, lane.top + lane.height / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillStyle = "#747a82";
    pen.fillText(lane.scale, 0, 0);
    pen.restore();
  }

  yOf(lane, value) {
    return lane.top + lane.height * (1 - (value - lane.low) / (lane.high - lane.low));
  }

  drawCurve(pen, lane, channel) {
    const { times } = this.curves;
    const first = Math.max(this.curves.frameAt(this.view[0]) - 1, 0);
    const last = Math.min(this.curves.frameAt(this.view[1]) + 2, times.length);
    pen.strokeStyle = this.colors.get(channel);
    pen.globalAlpha = this.strong && this.strong !== channel ? 0.25 : 1;
    pen.lineWidth = this.strong === channel ? 2.4 : 1.6;
    pen.lineJoin = "round";
    pen.beginPath();
    if (last - first > 3 * this.width) this.traceColumns(pen, lane, channel, first, last);
    else this.tracePoints(pen, lane, channel, first, last);
    pen.stroke();
    pen.globalAlpha = 1;
  }

  tracePoints(pen, lane, channel, first, last) {
    let isDown = false, y = 0;
    for (let i = first; i < last; i++) {
      const value = channel.values[i];
      if (Number.isNaN(value)) { isDown = false; continue; }
      const x = this.xOf(this.curves.times[i]);
      if (isDown && channel.isHeld) pen.lineTo(x, y);
      y = this.yOf(lane, value);
      if (isDown) pen.lineTo(x, y);
      else { pen.moveTo(x - 0.75, y); pen.lineTo(x, y); } // a lone value is a dot
      isDown = true;
    }
  }

  /** Many frames in a column of pixels: from its lowest to its highest value. */
  traceColumns(pen, lane, channel, first, last) {
    let column = null, low = 0, high = 0, isDown = false;
    const flush = () => {
      if (column === null) return;
      if (isDown) pen.lineTo(column, this.yOf(lane, low)); else pen.moveTo(column, this.yOf(lane, low));
      pen.lineTo(column, this.yOf(lane, high));
      isDown = true;
    };
    for (let i = first; i < last; i++) {
      const value = channel.values[i];
      if (Number.isNaN(value)) { flush(); column = null; isDown = false; continue; }
      const x = Math.round(this.xOf(this.curves.times[i]));
      if (x !== column) { flush(); column = x; low = high = value; }
      else { low = Math.min(low, value); high = Math.max(high, value); }
    }
    flush();
  }

  drawCursor() {
    const pen = this.fit(this.top);
    const bottom = this.box.clientHeight - MARGIN.bottom;
    const line = (time, color, width) => {
      const x = this.xOf(time);
      if (x < MARGIN.left - 1 || x > MARGIN.left + this.width + 1) return null;
      pen.strokeStyle = color;
      pen.lineWidth = width;
      pen.beginPath(); pen.moveTo(x, MARGIN.top - 6); pen.lineTo(x, bottom); pen.stroke();
      return x;
    };
    if (this.pointed != null) line(this.curves.times[this.pointed], "#7b828a", 1);
    const x = line(this.clock.time, "#ffffff", 1.4);
    if (x === null) return;
    const frame = this.curves.frameAt(this.clock.time);
    for (const lane of this.drawn ?? []) {
      for (const channel of lane.channels) {
        const value = channel.values[frame];
        if (Number.isNaN(value)) continue;
        pen.fillStyle = this.colors.get(channel);
        pen.beginPath(); pen.arc(x, this.yOf(lane, value), 3.2, 0, 2 * Math.PI); pen.fill();
      }
    }
  }

  /** Follow the clock: cursor, values in the legend, page of a zoomed view. */
  follow() {
    const { time, duration, isPlaying } = this.clock;
    if (this.zoom && isPlaying && (time > this.zoom[1] || time < this.zoom[0])) {
      const span = this.zoom[1] - this.zoom[0];
      const from = Math.min(Math.max(time - span * 0.05, 0), duration - span);
      this.zoom = [from, from + span];
      this.drawBase();
    }
    this.drawCursor();
    const frame = this.curves.frameAt(time);
    for (const [channel, output] of this.readouts ?? []) {
      const text = formatValue(channel.values[frame], channel.unit);
      if (output.value !== text) output.value = text;
    }
    this.box.setAttribute("aria-valuenow", time.toFixed(3));
    this.box.setAttribute("aria-valuetext", `${time.toFixed(3)} seconds, frame ${frame}`);
  }

  // pointer

  listen() {
    const { box } = this;
    const at = (event) => event.clientX - box.getBoundingClientRect().left;
    box.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      box.setPointerCapture(event.pointerId);
      this.isDragging = true;
      this.clock.seek(this.clock.snapped(this.timeAt(at(event))));
    });
    box.addEventListener("pointermove", (event) => {
      if (this.isDragging) this.clock.seek(this.clock.snapped(this.timeAt(at(event))));
      this.point(at(event), event.clientY - box.getBoundingClientRect().top);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      box.addEventListener(name, () => { this.isDragging = false; });
    }
    box.addEventListener("pointerleave", () => {
      this.pointed = null; this.hover.hidden = true; this.drawCursor();
    });
    box.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // a plain wheel scrolls the page
      event.preventDefault();
      this.zoomBy(event.deltaY < 0 ? 0.8 : 1.25, this.timeAt(at(event)));
    }, { passive: false });
  }

  point(x, y) {
    const time = this.timeAt(x);
    const frame = this.curves.nearest(time);
    this.pointed = frame;
    this.hover.hidden = !this.colors.size;
    const rows = [...this.colors].map(([channel, color]) => element("div", { style: `--c: ${color}` },
      element("i"), channel.name, element("b", {},
        `${formatValue(channel.values[frame], channel.unit)} ${channel.unit}`
        + inDegrees(channel.values[frame], channel.unit))));
    const when = `${this.curves.times[frame].toFixed(3)} s · frame ${frame}`;
    this.hover.replaceChildren(element("p", {}, when), ...rows);
    const { offsetWidth: w, offsetHeight: h } = this.hover;
    const right = x + 16 + w > this.box.clientWidth ? x - 16 - w : x + 16;
    this.hover.style.left = `${Math.max(right, 0)}px`;
    this.hover.style.top = `${Math.max(0, Math.min(y - h / 2, this.box.clientHeight - h))}px`;
    this.drawCursor();
  }

  zoomBy(factor, about = this.clock.time) {
    const { duration } = this.clock;
    const [from, to] = this.view;
    const span = Math.max((to - from) * factor, Math.min(duration, 0.1));
    if (span >= duration) { this.zoom = null; this.draw(); return; }
    const share = (about - from) / (to - from);
    const start = Math.min(Math.max(about - share * span, 0), duration - span);
    this.zoom = [start, start + span];
    this.draw();
  }
}

/** The list of channels, grouped by region of the face, with a search field. */
function buildPicker(curves, plot) {
  const boxes = new Map();
  const groups = new Map(curves.regions.map((region) => [region, []]));
  for (const channel of curves.channels) {
    const box = element("input", {
      type: "checkbox", onchange: (event) => plot.toggle(channel, event.target.checked),
    });
    const row = element("label", { title: channel.title }, box, element("span", {}, channel.name), element("i"));
    boxes.set(channel, { box, row });
    groups.get(channel.region).push({ channel, row });
  }
  const none = element("p", { class: "none", hidden: true }, "No channel has this in its name.");
  const folds = [...groups].filter(([, rows]) => rows.length).map(([region, rows]) => {
    const count = element("span");
    const fold = element("details", {}, element("summary", {}, region, count), ...rows.map((r) => r.row));
    return { fold, rows, count };
  });
  const recount = () => {
    for (const { rows, count } of folds) {
      const shown = rows.filter(({ channel }) => plot.colors.has(channel)).length;
      count.textContent = shown ? `${shown} of ${rows.length}` : `${rows.length}`;
    }
  };
  const filter = (text) => {
    const words = text.toLowerCase().split(/[\s_]+/).filter(Boolean);
    let found = 0;
    for (const { fold, rows } of folds) {
      let here = 0;
      for (const { channel, row } of rows) {
        const name = `${channel.name} ${channel.region} ${channel.title}`.toLowerCase();
        const fits = words.every((word) => name.includes(word));
        row.hidden = !fits;
        here += fits;
      }
      fold.hidden = !here;
      fold.open = words.length ? here > 0 : rows.some(({ channel }) => plot.colors.has(channel));
      found += here;
    }
    none.hidden = found > 0;
  };
  plot.onchange = (channel, isOn, color) => {
    const { box, row } = boxes.get(channel);
    box.checked = isOn;
    if (color) row.style.setProperty("--c", color);
    recount();
  };
  const search = element("input", {
    type: "search", placeholder: "Search channels", "aria-label": "Search channels",
    oninput: (event) => filter(event.target.value),
  });
  const clear = element("button", {
    type: "button", class: "small", title: "Hide all curves",
    onclick: () => { for (const channel of [...plot.colors.keys()]) plot.toggle(channel, false); },
  }, "clear");
  const picker = element("aside", { class: "picker", "aria-label": "Channels" },
    element("div", { class: "picker-head" }, search, clear),
    element("div", { class: "picker-list" }, ...folds.map((f) => f.fold), none));
  return { picker, refresh: () => { recount(); filter(""); } };
}

function buildCurves(config, clock) {
  const curves = new Curves(config);
  const plot = new Plot(curves, clock);
  const { picker, refresh } = buildPicker(curves, plot);
  const zooms = element("div", { class: "cluster", role: "group", "aria-label": "Zoom in time" },
    element("button", { type: "button", class: "small", "aria-label": "Zoom out", onclick: () => plot.zoomBy(2) }, "−"),
    element("button", { type: "button", class: "small", "aria-label": "Zoom in", title: "Zoom in (also Ctrl + wheel)", onclick: () => plot.zoomBy(0.5) }, "+"),
    element("button", { type: "button", class: "small", title: "Show the whole clip", onclick: () => plot.zoomBy(Infinity) }, "fit"));
  const panel = element("div", { class: "plot-panel" },
    element("div", { class: "plot-head" }, plot.legend, zooms), plot.box);
  const section = document.getElementById("curves");
  section.append(panel, picker);
  section.hidden = false;
  for (const i of config.shown) plot.toggle(curves.channels[i], true);
  plot.drawLegend();
  refresh();
  return { curves, plot };
}
