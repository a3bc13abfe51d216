// One clock drives everything on the page.

const SPEEDS = [0.25, 0.5, 1];
const ICONS = {
  play: "M7 4.5v15l13-7.5z",
  pause: "M6 4.5h4.2v15H6zm7.8 0H18v15h-4.2z",
  back: "M15.5 5v14L6 12zM18 5h-2v14h2z",
  on: "M8.5 5v14l9.5-7zM6 5h2v14H6z",
  start: "M5 5h2.2v14H5zM19 5v14L8.5 12z",
  loop: "M17 3.5 21.5 7 17 10.5V8.2H8.5A3.5 3.5 0 0 0 5 11.7v.8H2.8v-.8A5.7 5.7 0 0 1 8.5 6H17zM7 20.5 2.5 17 7 13.5v2.3h8.5a3.5 3.5 0 0 0 3.5-3.5v-.8h2.2v.8a5.7 5.7 0 0 1-5.7 5.7H7z",
  sound: "M4 9v6h4l5 4.5v-15L8 9zm11.5-.8v7.6a4.3 4.3 0 0 0 0-7.6zm0-4.2v2.2a6.2 6.2 0 0 1 0 11.6V20a8.3 8.3 0 0 0 0-16z",
  mute: "M4 9v6h4l5 4.5v-15L8 9zm17.5.4L20.1 8l-2.1 2.1L15.9 8l-1.4 1.4 2.1 2.1-2.1 2.1 1.4 1.4 2.1-2.1 2.1 2.1 1.4-1.4-2.1-2.1z",
};

class Clock {
  constructor(frames) {
    this.frames = frames; // {times} where they are known one by one, or {rate}, or null
    this.time = 0;
    this.duration = 0;
    this.speed = 1;
    this.isLooping = true;
    this.isPlaying = false;
    this.followers = [];
    this.videos = [];
  }

  get frame_s() { return this.frames?.step ?? 1 / 25; }

  frameOf(time) {
    if (!this.frames) return null;
    if (this.frames.at) return this.frames.at(time);
    return Math.floor((time + INSIDE_FRAME_S) * this.frames.rate);
  }

  timeOf(frame) {
    const time = this.frames?.times
      ? this.frames.times[Math.min(Math.max(frame, 0), this.frames.times.length - 1)]
      : frame * this.frame_s;
    return Math.min(Math.max(time, 0), this.duration);
  }

  snapped(time) {
    return this.frames?.nearest ? this.timeOf(this.frames.nearest(time))
      : this.frames ? this.timeOf(Math.round(time * this.frames.rate)) : time;
  }

  play() {
    if (this.isPlaying || !this.duration) return;
    if (this.time >= this.duration - 1e-3) this.time = 0;
    this.isPlaying = true;
    this.anchor();
    requestAnimationFrame(() => this.tick());
    this.changed();
  }

  /** Resolves when all pictures show the time at which they stopped. */
  async pause() {
    if (!this.isPlaying) return;
    this.time = this.current();
    this.isPlaying = false;
    this.changed();
    await this.seek(this.time);
  }

  toggle() { if (this.isPlaying) this.pause(); else this.play(); }

  /** Go to a time. Resolves when all pictures show it. */
  async seek(time) {
    if (!Number.isFinite(time)) throw new TypeError("seek takes a number of seconds");
    this.time = Math.min(Math.max(time, 0), this.duration);
    this.anchor();
    this.show();
    for (const video of this.videos) video.lastFollowed = -Infinity;
    if (!this.isPlaying) await Promise.all(this.videos.map((video) => video.show(this.time)));
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  }

  step(frames) {
    this.pause();
    const here = this.frameOf(this.time);
    this.seek(here === null ? this.time + frames * this.frame_s : this.timeOf(here + frames));
  }

  setSpeed(speed) { this.time = this.current(); this.speed = speed; this.anchor(); this.changed(); }
  setLooping(isLooping) { this.isLooping = isLooping; this.changed(); }

  anchor() { this.from = this.time; this.since = performance.now(); }

  /** The time at this very moment, which pictures drawn a while ago may lag behind. */
  current() {
    if (!this.isPlaying) return this.time;
    return Math.min(this.from + ((performance.now() - this.since) / 1000) * this.speed, this.duration);
  }

  tick() {
    if (!this.isPlaying) return;
    this.time = this.current(); // not the time stamp of the tick: drawing a model may take longer
    const now = performance.now();
    if (this.time >= this.duration) {
      this.time = this.isLooping ? 0 : this.duration;
      this.anchor();
      if (!this.isLooping) { this.pause(); return; }
    }
    for (const video of this.videos) video.follow(this.time, this.speed, this.frame_s, now);
    this.show();
    requestAnimationFrame(() => this.tick());
  }

  show() { for (const follow of this.followers) follow(this.time); }
  changed() { this.onchange?.(); }
}

function toggleButton(label, path, onclick) {
  return element("button", { type: "button", "aria-label": label, title: label, onclick }, icon(path));
}

function buildTransport(clock, videos) {
  const swap = (button, path, label) => {
    button.replaceChildren(icon(path));
    button.setAttribute("aria-label", label);
    button.title = label;
  };
  const play = toggleButton("Play (space)", ICONS.play, () => clock.toggle());
  play.classList.add("play");
  const loop = toggleButton("Loop (L)", ICONS.loop, () => clock.setLooping(!clock.isLooping));
  const speeds = SPEEDS.map((speed) => element("button", {
    type: "button", onclick: () => clock.setSpeed(speed), "aria-label": `Speed ${speed}`,
  }, `${speed}×`));
  const seconds = element("b"), frames = element("span"), total = element("span");
  const seek = element("input", {
    type: "range", class: "seek", min: "0", step: "any", value: "0", "aria-label": "Time",
    oninput: (event) => clock.seek(clock.snapped(Number(event.target.value))),
  });
  const parts = [
    element("div", { class: "cluster" },
      toggleButton("To the start (home)", ICONS.start, () => clock.seek(0)),
      toggleButton("One frame back (←)", ICONS.back, () => clock.step(-1)), play,
      toggleButton("One frame on (→)", ICONS.on, () => clock.step(1)), loop),
    element("div", { class: "cluster speeds", role: "group", "aria-label": "Speed" }, ...speeds),
    element("div", { class: "clock" }, seconds, total, frames), seek,
  ];
  if (videos.length) {
    const { video } = videos[0];
    const sound = toggleButton("Sound off (M)", ICONS.sound, () => { video.muted = !video.muted; });
    sound.dataset.role = "sound";
    video.addEventListener("volumechange", () => swap(sound, video.muted ? ICONS.mute : ICONS.sound,
      video.muted ? "Sound on (M)" : "Sound off (M)"));
    parts.splice(2, 0, sound);
  }
  const refresh = () => {
    swap(play, clock.isPlaying ? ICONS.pause : ICONS.play, clock.isPlaying ? "Pause (space)" : "Play (space)");
    loop.setAttribute("aria-pressed", clock.isLooping);
    speeds.forEach((button, i) => button.setAttribute("aria-pressed", SPEEDS[i] === clock.speed));
    seek.max = clock.duration;
    total.textContent = `/ ${clock.duration.toFixed(2)} s`;
  };
  const follow = (time) => {
    seconds.textContent = time.toFixed(3);
    const frame = clock.frameOf(time);
    if (frame !== null) frames.textContent = `frame ${frame}`;
    seek.value = time;
    seek.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds`);
  };
  const section = document.getElementById("transport");
  section.append(...parts);
  section.hidden = false;
  return { refresh, follow };
}

function listenToKeys(clock, videos) {
  const actions = {
    " ": () => clock.toggle(), k: () => clock.toggle(),
    ArrowLeft: (e) => (e.shiftKey ? clock.seek(clock.time - 1) : clock.step(-1)),
    ArrowRight: (e) => (e.shiftKey ? clock.seek(clock.time + 1) : clock.step(1)),
    ",": () => clock.step(-1), ".": () => clock.step(1),
    Home: () => clock.seek(0), End: () => clock.seek(clock.duration),
    l: () => clock.setLooping(!clock.isLooping),
    m: () => { if (videos.length) videos[0].video.muted = !videos[0].video.muted; },
  };
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { target } = event;
    if (target.matches?.("input[type=search]")) return;
    // a focused model turns with the arrow keys, a button or check box works with the space bar
    if (target.matches?.("model-viewer") && event.key.startsWith("Arrow")) return;
    if (event.key === " " && target.matches?.("button, summary, input[type=checkbox]")) return;
    const action = actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    action(event);
  }, { capture: true });
}

function framesOf(config, curves) {
  if (curves?.times.length > 1) {
    const { times } = curves;
    return {
      times, step: (times[times.length - 1] - times[0]) / (times.length - 1),
      at: (time) => curves.frameAt(time), nearest: (time) => curves.nearest(time),
    };
  }
  return config.rate ? { rate: config.rate, step: 1 / config.rate } : null;
}

function main() {
  const config = JSON.parse(document.getElementById("config").textContent);
  const clock = new Clock(null);
  const { videos, models } = buildStage(config);
  clock.videos = videos;
  const plotted = config.curves ? buildCurves(config.curves, clock) : null;
  clock.frames = framesOf(config, plotted?.curves);
  const panes = [...videos, ...models];
  const isTimed = panes.length > 0 || plotted !== null;
  clock.followers = models.map((model) => (time) => model.show(time));
  if (plotted) clock.followers.push(() => plotted.plot.follow());
  document.body.classList.toggle("has-curves", plotted !== null);
  document.getElementById("keys").hidden = !isTimed;
  if (isTimed) {
    const transport = buildTransport(clock, videos);
    clock.onchange = transport.refresh;
    clock.followers.push(transport.follow);
    listenToKeys(clock, videos);
  }
  const measure = () => {
    clock.duration = Math.max(0, plotted?.curves.end ?? 0, ...panes.map((pane) => pane.end));
    clock.changed();
    plotted?.plot.draw();
    clock.show();
  };
  measure();
  const ready = Promise.all(panes.map((pane) => pane.ready)).then(() => { measure(); return clock.seek(0); });
  window.facewright = {
    ready,
    seek: (time) => clock.seek(time),
    play: () => clock.play(),
    pause: () => clock.pause(),
    time: () => clock.current(),
    state: () => ({
      time: clock.current(), frame: clock.frameOf(clock.time), duration: clock.duration,
      playing: clock.isPlaying, speed: clock.speed, looping: clock.isLooping,
      videoTime: videos[0]?.time ?? null, modelTime: models[0]?.time ?? null,
    }),
  };
}

main();
