// The plot: the sound's picture and the chosen curves over one time axis, with a moving cursor.

const MARGIN = { left: 62, right: 14, top: 10, bottom: 24 };
const LANE_GAP = 14;
const WAVE_HEIGHT = 54;
const LANE_LEAST = 64;

class Plot {
  constructor(set, wave, clock) {
    this.set = set;
    this.wave = wave;
    this.clock = clock;
    this.colors = new Map(); // a channel's name to its place among the colours
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

  colorOf(name) {
    const { series } = palette();
    return series[this.colors.get(name) % series.length];
  }

  toggle(name, isOn) {
    if (isOn && !this.colors.has(name)) {
      const used = new Set(this.colors.values());
      let free = 0;
      while (used.has(free)) free += 1;
      this.colors.set(name, free);
    }
    if (!isOn) this.colors.delete(name);
    this.drawLegend();
    this.draw();
    this.onchange?.(name);
  }

  drawLegend() {
    this.readouts = new Map();
    const clips = this.set.clips.length > 1 ? this.set.clips.map((clip, i) => element("li", {
      class: "clip",
    }, dashIcon(DASHES[i % DASHES.length]), clip.label)) : [];
    const rows = [...this.colors.keys()].map((name) => {
      const channel = this.set.channels.get(name);
      const value = element("output");
      this.readouts.set(name, value);
      return element("li", {}, element("button", {
        type: "button", style: `--c: ${this.colorOf(name)}`, title: `Hide ${name}`,
        onclick: () => this.toggle(name, false),
        onpointerenter: () => { this.strong = name; this.draw(); },
        onpointerleave: () => { this.strong = null; this.draw(); },
      }, element("i"), name, value, element("small", {}, channel.unit)));
    });
    this.legend.replaceChildren(...clips, ...rows);
    const scales = new Set([...this.colors.keys()].map((name) => this.set.channels.get(name).scale));
    this.box.style.minHeight = `${this.aboveLanes + MARGIN.bottom + scales.size * (LANE_LEAST + LANE_GAP)}px`;
    if (this.set.channels.size && !rows.length) {
      this.legend.append(element("li", { class: "none" }, "Choose channels to plot."));
    }
    if (!this.set.channels.size && this.wave) {
      this.legend.append(element("li", { class: "none" }, this.wave.label));
    }
  }

  // where things are

  get view() { return this.zoom ?? [0, Math.max(this.clock.duration, 1e-3)]; }
  get aboveLanes() { return MARGIN.top + (this.wave ? WAVE_HEIGHT + LANE_GAP : 0); }
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

  /** One lane for each scale: FAP units, angles, weights; below that of the sound. */
  lanes() {
    const byScale = new Map();
    for (const name of this.colors.keys()) {
      const channel = this.set.channels.get(name);
      if (!byScale.has(channel.scale)) byScale.set(channel.scale, []);
      byScale.get(channel.scale).push(channel);
    }
    const above = this.aboveLanes;
    const height = this.box.clientHeight - above - MARGIN.bottom;
    const each = (height - LANE_GAP * (byScale.size - 1)) / Math.max(byScale.size, 1);
    return [...byScale].map(([scale, channels], i) => {
      let low = 0, high = 0;
      for (const { range } of channels) { low = Math.min(low, range[0]); high = Math.max(high, range[1]); }
      if (high - low < 1e-9) { low -= 0.5; high += 0.5; }
      const pad = (high - low) * 0.06;
      const top = above + i * (each + LANE_GAP);
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
    if (this.wave) this.drawWave(pen);
    for (const lane of this.drawn) {
      this.drawLane(pen, lane);
      pen.save();
      pen.beginPath();
      pen.rect(MARGIN.left, lane.top - 2, this.width, lane.height + 4);
      pen.clip();
      for (const channel of lane.channels) {
        this.set.clips.forEach((clip, i) => this.drawCurve(pen, lane, clip, channel.name, DASHES[i % DASHES.length]));
      }
      pen.restore();
    }
    this.box.setAttribute("aria-valuemax", this.clock.duration.toFixed(3));
  }

  drawTimeAxis(pen) {
    const ink = palette();
    const [from, to] = this.view;
    const bottom = this.box.clientHeight - MARGIN.bottom;
    const step = niceStep(to - from, this.width / 90);
    const digits = Math.max(0, -Math.floor(Math.log10(step)));
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (let k = Math.ceil(from / step - 1e-9); k * step <= to + 1e-9; k++) {
      const x = Math.round(this.xOf(k * step)) + 0.5;
      pen.strokeStyle = ink.grid;
      pen.beginPath(); pen.moveTo(x, MARGIN.top); pen.lineTo(x, bottom); pen.stroke();
      pen.fillStyle = ink.tick;
      pen.fillText(`${(k * step).toFixed(digits)} s`, x, bottom + 7);
    }
  }

  drawWave(pen) {
    const middle = MARGIN.top + WAVE_HEIGHT / 2, half = WAVE_HEIGHT / 2;
    const [from, to] = this.view;
    const each = (to - from) / this.width;
    pen.fillStyle = palette().wave;
    for (let x = 0; x < this.width; x++) {
      const found = this.wave.between(from + x * each, from + (x + 1) * each);
      if (!found) continue;
      const top = middle - half * found[1], bottom = middle - half * found[0];
      pen.fillRect(MARGIN.left + x, Math.min(top, middle - 0.5), 1, Math.max(bottom - top, 1));
    }
    this.nameLane(pen, "sound", MARGIN.top, WAVE_HEIGHT);
  }

  nameLane(pen, name, top, height) {
    pen.save();
    pen.translate(10, top + height / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillStyle = palette().label;
    pen.fillText(name, 0, 0);
    pen.restore();
  }

  drawLane(pen, lane) {
    const ink = palette();
    const yOf = (value) => this.yOf(lane, value);
    const step = niceStep(lane.high - lane.low, lane.height / 17);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let k = Math.ceil(lane.low / step); k * step <= lane.high; k++) {
      const y = Math.round(yOf(k * step)) + 0.5;
      pen.strokeStyle = k === 0 ? ink.zero : ink.grid;
      pen.beginPath(); pen.moveTo(MARGIN.left, y); pen.lineTo(MARGIN.left + this.width, y); pen.stroke();
      pen.fillStyle = ink.tick;
      const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      const tick = step >= 5000 ? `${(k * step) / 1000}k`.replace(/^0k$/, "0") : (k * step).toFixed(digits);
      pen.fillText(tick.replace("-", "−"), MARGIN.left - 8, y);
    }
    if (lane.scale) this.nameLane(pen, lane.scale, lane.top, lane.height);
  }

  yOf(lane, value) {
    return lane.top + lane.height * (1 - (value - lane.low) / (lane.high - lane.low));
  }

  drawCurve(pen, lane, clip, name, dash) {
    const channel = clip.byName.get(name);
    if (!channel) return;
    const { times } = clip;
    const first = Math.max(clip.frameAt(this.view[0]) - 1, 0);
    const last = Math.min(clip.frameAt(this.view[1]) + 2, times.length);
    pen.strokeStyle = this.colorOf(name);
    pen.globalAlpha = this.strong && this.strong !== name ? 0.25 : 1;
    pen.lineWidth = this.strong === name ? 2.4 : 1.6;
    pen.lineJoin = "round";
    pen.setLineDash(dash);
    pen.beginPath();
    if (last - first > 3 * this.width) this.traceColumns(pen, lane, clip, channel, first, last);
    else this.tracePoints(pen, lane, clip, channel, first, last);
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  tracePoints(pen, lane, clip, channel, first, last) {
    let isDown = false, y = 0;
    for (let i = first; i < last; i++) {
      const value = channel.values[i];
      if (Number.isNaN(value)) { isDown = false; continue; }
      const x = this.xOf(clip.timeOf(i));
      if (isDown && channel.isHeld) pen.lineTo(x, y);
      y = this.yOf(lane, value);
      if (isDown) pen.lineTo(x, y);
      else { pen.moveTo(x - 0.75, y); pen.lineTo(x, y); } // a lone value is a dot
      isDown = true;
    }
  }

  /** Many frames in a column of pixels: from its lowest to its highest value. */
  traceColumns(pen, lane, clip, channel, first, last) {
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
      const x = Math.round(this.xOf(clip.timeOf(i)));
      if (x !== column) { flush(); column = x; low = high = value; }
      else { low = Math.min(low, value); high = Math.max(high, value); }
    }
    flush();
  }

  drawCursor() {
    const pen = this.fit(this.top);
    const ink = palette();
    const bottom = this.box.clientHeight - MARGIN.bottom;
    this.drawRange(pen, bottom);
    const line = (time, color, width) => {
      const x = this.xOf(time);
      if (x < MARGIN.left - 1 || x > MARGIN.left + this.width + 1) return null;
      pen.strokeStyle = color;
      pen.lineWidth = width;
      pen.beginPath(); pen.moveTo(x, MARGIN.top - 6); pen.lineTo(x, bottom); pen.stroke();
      return x;
    };
    if (this.pointed != null) line(this.pointed, ink.pointed, 1);
    const x = line(this.clock.time, ink.cursor, 1.4);
    if (x === null) return;
    for (const lane of this.drawn ?? []) {
      for (const { name } of lane.channels) {
        for (const value of this.set.valuesAt(name, this.clock.time)) {
          if (Number.isNaN(value)) continue;
          pen.fillStyle = this.colorOf(name);
          pen.beginPath(); pen.arc(x, this.yOf(lane, value), 3.2, 0, 2 * Math.PI); pen.fill();
        }
      }
    }
  }

  /** What lies outside the in and out points is dimmed. */
  drawRange(pen, bottom) {
    const { clock } = this;
    pen.fillStyle = palette().range;
    const dim = (from, to) => {
      const left = Math.max(this.xOf(from), MARGIN.left);
      const right = Math.min(this.xOf(to), MARGIN.left + this.width);
      if (right > left) pen.fillRect(left, MARGIN.top - 6, right - left, bottom - MARGIN.top + 6);
    };
    if (clock.inPoint !== null) dim(0, clock.inPoint);
    if (clock.outPoint !== null) dim(clock.outPoint, clock.duration);
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
    for (const [name, output] of this.readouts ?? []) {
      const { unit } = this.set.channels.get(name);
      const text = this.set.valuesAt(name, time).map((value) => formatValue(value, unit)).join(" | ");
      if (output.value !== text) output.value = text;
    }
    this.box.setAttribute("aria-valuenow", time.toFixed(3));
    const frame = this.clock.frameOf(time);
    const named = frame === null ? "" : `, frame ${frame}`;
    this.box.setAttribute("aria-valuetext", `${time.toFixed(3)} seconds${named}`);
  }
}

function dashIcon(dash) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const line = document.createElementNS("http://www.w3.org/2000/svg", "path");
  svg.setAttribute("viewBox", "0 0 28 4");
  svg.setAttribute("aria-hidden", "true");
  line.setAttribute("d", "M0 2h28");
  line.setAttribute("stroke-dasharray", dash.join(" "));
  svg.append(line);
  return svg;
}
