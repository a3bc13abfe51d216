// One clock drives everything on the page. Where there is sound, the sound is the clock.

const SPEEDS = [0.25, 0.5, 1, 2];
const SLOWEST = 0.1, FASTEST = 8; // what browsers play sound at
const LEAD_END_S = 5e-3; // this near to its end a sound leads no more
const START_LIMIT_MS = 1500; // a sound that has not begun by then leads no more

/** A sound, or a video with sound, that the clock follows while it plays. */
class Leader {
  constructor(media, start, ownTime = (time) => time - start) {
    this.media = media;
    this.start = start;
    this.ownTime = ownTime;
    this.state = "idle"; // or "starting", "leading", "failed"
  }

  get end() { return Number.isFinite(this.media.duration) ? this.start + this.media.duration : 0; }

  covers(time) {
    return this.media.readyState >= 1 && !this.media.error && this.state !== "failed"
      && time >= this.start && time < this.end - LEAD_END_S;
  }

  /** The time it is at; null while it is finding its place. */
  get time() {
    return this.state === "leading" && !this.media.seeking
      ? this.start + this.media.currentTime : null;
  }

  begin(time, speed) {
    this.state = "starting";
    this.since = performance.now();
    this.goTo(time);
    this.setSpeed(speed);
    this.run();
  }

  async run() {
    try {
      await this.media.play();
    } catch (error) {
      if (this.state !== "starting") return; // a pause that came in between
      if (error.name === "NotAllowedError" && !this.media.muted) {
        this.media.muted = this.isHushed = true; // sound waits for a click; the pictures need not
        this.run();
        return;
      }
      if (this.isHushed) this.media.muted = this.isHushed = false; // it was not that
      this.state = "failed"; // the pictures go on by themselves
      return;
    }
    if (this.state === "starting") this.state = "leading";
  }

  goTo(time) {
    const own = Math.min(Math.max(this.ownTime(time), 0), this.media.duration);
    if (Math.abs(this.media.currentTime - own) > INSIDE_FRAME_S) this.media.currentTime = own;
  }

  setSpeed(speed) { this.media.playbackRate = speed; }

  stop() {
    this.state = "idle";
    this.media.pause();
  }

  get isLate() {
    return this.time === null && performance.now() - this.since > START_LIMIT_MS;
  }
}

class Clock {
  constructor() {
    this.frames = null; // {times} where they are known one by one, or {rate}, or null
    this.time = 0;
    this.duration = 0;
    this.speed = 1;
    this.isLooping = true;
    this.isPlaying = false;
    this.inPoint = null;
    this.outPoint = null;
    this.followers = [];
    this.videos = [];
    this.leader = null;
  }

  get frame_s() { return this.frames?.step ?? 1 / 25; }
  get begin() { return this.inPoint ?? 0; }
  get finish() { return this.outPoint ?? this.duration; }

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
    if (this.time >= this.finish - 1e-3 || this.time < this.begin - 1e-3) this.time = this.begin;
    this.isPlaying = true;
    if (this.leader?.state === "failed") this.leader.state = "idle";
    this.anchor();
    requestAnimationFrame(() => this.tick());
    this.changed();
  }

  /** Resolves when all pictures show the time at which they stopped. */
  async pause() {
    if (!this.isPlaying) return;
    this.time = this.current();
    this.isPlaying = false;
    this.leader?.stop();
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
    else if (this.leader && this.leader.state !== "idle") this.lead(this.time);
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  }

  step(frames) {
    this.pause();
    const here = this.frameOf(this.time);
    this.seek(here === null ? this.time + frames * this.frame_s : this.timeOf(here + frames));
  }

  setSpeed(speed) {
    if (!Number.isFinite(speed)) return;
    this.time = this.current();
    this.speed = Math.min(Math.max(speed, SLOWEST), FASTEST);
    this.leader?.setSpeed(this.speed);
    this.anchor();
    this.changed();
  }

  setLooping(isLooping) { this.isLooping = isLooping; this.changed(); }

  /** Play only from `from` to `to`, seconds; null for the clip's own ends. */
  setRange(from, to) {
    const inside = (time) => (time === null ? null : Math.min(Math.max(time, 0), this.duration));
    [this.inPoint, this.outPoint] = [inside(from), inside(to)];
    if (this.inPoint !== null && this.outPoint !== null && this.finish - this.begin < 1e-3) {
      this.outPoint = null; // an end that is not after the beginning is none
    }
    this.changed();
  }

  setIn() { this.setRange(this.time, this.outPoint > this.time ? this.outPoint : null); }
  setOut() { this.setRange(this.inPoint < this.time ? this.inPoint : null, this.time); }

  anchor() { this.from = this.time; this.since = performance.now(); }

  /** The time at this very moment, which pictures drawn a while ago may lag behind. */
  current() {
    if (!this.isPlaying) return this.time;
    const led = this.leader?.time ?? null;
    if (led !== null) return Math.min(led, this.finish);
    if (this.leader?.state === "starting" || this.leader?.state === "leading") return this.time;
    return Math.min(this.from + ((performance.now() - this.since) / 1000) * this.speed, this.finish);
  }

  /** Start, keep or end the leader's part at a time. True while the time is the leader's. */
  followLeader() {
    const { leader } = this;
    if (!leader) return false;
    if (!leader.covers(this.time) || leader.media.ended) {
      if (leader.state === "leading" || leader.state === "starting") leader.stop();
      if (!leader.covers(this.time)) return false;
    }
    if (leader.state === "leading" && leader.media.paused) leader.state = "idle"; // after its end
    if (leader.state === "idle") leader.begin(this.time, this.speed);
    if (leader.isLate) { leader.stop(); leader.state = "failed"; this.anchor(); return false; }
    if (leader.time !== null) this.time = leader.time;
    this.anchor();
    return true;
  }

  /** Take the leader along to a time. */
  lead(time) {
    if (!this.leader) return;
    if (this.leader.covers(time)) { this.leader.goTo(time); this.leader.since = performance.now(); }
    else this.leader.stop();
  }

  tick() {
    if (!this.isPlaying) return;
    // not the time stamp of the tick: drawing a model may take longer
    const isLed = this.followLeader();
    if (!isLed) this.time = this.current();
    const now = performance.now();
    if (this.time >= this.finish - 1e-9) {
      this.time = this.isLooping ? this.begin : this.finish;
      this.anchor();
      if (!this.isLooping) { this.end(); return; }
      this.lead(this.time);
    }
    for (const video of this.videos) {
      if (isLed && video.video === this.leader.media) continue; // it is the clock
      video.follow(this.time, this.speed, this.frame_s, now);
    }
    this.show();
    requestAnimationFrame(() => this.tick());
  }

  end() {
    this.isPlaying = false;
    this.leader?.stop();
    this.changed();
    this.seek(this.finish);
  }

  show() { for (const follow of this.followers) follow(this.time); }
  changed() { this.onchange?.(); }
}

function framesOf(config, clip) {
  if (clip && clip.times.length > 1) {
    const times = Float64Array.from(clip.times, (time) => time + clip.start);
    return {
      times, step: (times[times.length - 1] - times[0]) / (times.length - 1),
      at: (time) => clip.frameAt(time), nearest: (time) => clip.nearest(time),
    };
  }
  return config.rate ? { rate: config.rate, step: 1 / config.rate } : null;
}

/** What the clock follows: the page's sound, else the first video if it has any. */
async function leaderOf(config, videos) {
  if (config.sound && !config.sound.isInVideo) {
    const audio = element("audio", { preload: "auto" });
    const settled = once(audio, ["canplay", "error"]);
    audio.src = URL.createObjectURL(new Blob([await takeBytes("sound")], { type: config.sound.type }));
    await settled;
    return new Leader(audio, config.sound.start);
  }
  if (!config.videos[0]?.hasSound) return null;
  const [pane] = videos;
  await pane.ready;
  return new Leader(pane.video, pane.start, (time) => pane.own(time));
}
