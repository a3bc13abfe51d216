// Curves of one clip or of several that are compared, and the picture of a sound.

const HELD = /^(viseme|expression)\./; // held from key to key, not interpolated
const DASHES = [[], [6, 4], [2, 3], [9, 3, 2, 3]]; // tell clips apart

class Curves {
  constructor({ label, start, channels }, times, values) {
    this.label = label;
    this.start = start;
    this.times = new Float64Array(times.buffer);
    this.channels = channels;
    const all = new Float32Array(values.buffer); // one channel after another
    this.byName = new Map(channels.map((channel, i) => [channel.name, {
      ...channel, isHeld: HELD.test(channel.name),
      values: all.subarray(i * this.times.length, (i + 1) * this.times.length),
    }]));
  }

  static async load(config) {
    const [times, values] = await Promise.all(
      [takeBytes(`${config.id}-times`), takeBytes(`${config.id}-values`)]);
    return new Curves(config, times, values);
  }

  get end() { return this.times.length ? this.start + this.times[this.times.length - 1] : 0; }

  timeOf(frame) { return this.times[frame] + this.start; }

  /** The last frame that is not after a time, rounding apart. */
  frameAt(time) {
    const own = time - this.start + INSIDE_FRAME_S;
    let low = 0, high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= own) low = middle + 1; else high = middle;
    }
    return Math.max(low - 1, 0);
  }

  /** The frame that is nearest to a time. */
  nearest(time) {
    const i = this.frameAt(time);
    const next = Math.min(i + 1, this.times.length - 1);
    const own = time - this.start;
    return Math.abs(this.times[next] - own) < Math.abs(this.times[i] - own) ? next : i;
  }

  /** A channel's value at a time; NaN where it has none, or the clip has ended. */
  valueAt(name, time) {
    if (time > this.end + 2 * INSIDE_FRAME_S || time < this.timeOf(0) - 2 * INSIDE_FRAME_S) return NaN;
    return this.byName.get(name)?.values[this.frameAt(time)] ?? NaN;
  }
}

/** All clips together: a channel is known by its name. */
class CurveSet {
  constructor(clips, regions) {
    this.clips = clips;
    this.regions = regions;
    this.channels = new Map(); // name to what is told of it, its range over all clips
    for (const clip of clips) {
      for (const channel of clip.byName.values()) {
        const known = this.channels.get(channel.name);
        const range = known
          ? [Math.min(known.range[0], channel.range[0]), Math.max(known.range[1], channel.range[1])]
          : channel.range;
        this.channels.set(channel.name, { ...channel, values: undefined, range });
      }
    }
  }

  get end() { return Math.max(0, ...this.clips.map((clip) => clip.end)); }

  /** Values of a channel at a time, one for each clip that has it. */
  valuesAt(name, time) {
    return this.clips.filter((clip) => clip.byName.has(name))
      .map((clip) => clip.valueAt(name, time));
  }
}

/** The lowest and highest sample of each column of a sound's picture. */
class Wave {
  constructor({ label, start, duration, peaksRate }, bytes) {
    this.label = label;
    this.start = start;
    this.end = start + duration;
    this.rate = peaksRate;
    this.peaks = new Int8Array(bytes.buffer);
    let loudest = 1;
    for (const peak of this.peaks) loudest = Math.max(loudest, Math.abs(peak));
    this.loudest = loudest; // fills the lane: a recording is often far below what its file could hold
  }

  /** Lowest and highest between two times, ±1 for the loudest; null outside the sound. */
  between(from, to) {
    const last = this.peaks.length / 2 - 1;
    const first = Math.floor((from - this.start) * this.rate);
    const end = Math.max(Math.ceil((to - this.start) * this.rate), first + 1);
    if (end <= 0 || first > last) return null;
    let low = 127, high = -127;
    for (let i = Math.max(first, 0); i < Math.min(end, last + 1); i++) {
      low = Math.min(low, this.peaks[2 * i]);
      high = Math.max(high, this.peaks[2 * i + 1]);
    }
    return [low / this.loudest, high / this.loudest];
  }
}

function formatValue(value, unit) {
  if (Number.isNaN(value)) return "–";
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
