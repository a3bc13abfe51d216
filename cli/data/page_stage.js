// Pictures that follow a clock: models and videos.

const FOLLOW_EVERY_MS = 400; // a video that runs freely is put right at most this often
const BEFORE_END_S = 1e-4; // at its very end, a model's animation starts anew
const FIELD_OF_VIEW = "22deg";

function paneOf(kind, label, picture) {
  return element("figure", { class: `pane ${kind}` }, picture, element("figcaption", {}, label));
}

// A portrait studio as the viewer's surroundings, painted here: x is the direction, 192 of 256 the
// front, below that the viewer's right; y is the height, 64 the horizon. Intensities end at 1, so
// the exposure makes up for the dark walls.
const STUDIO = { width: 256, height: 128, walls: "#414141", exposure: 2.3, lamps: [
  { x: 210, y: 38, radius: 34, color: "255 251 244", power: 1 }, // key: large, soft, from above
  { x: 146, y: 56, radius: 30, color: "205 215 235", power: 0.6 }, // fill
  { x: 64, y: 34, radius: 30, color: "255 255 255", power: 0.8 }, // rim, from behind
] };

function paintStudio() {
  const { width, height, walls, lamps } = STUDIO;
  const canvas = element("canvas", { width, height });
  const pen = canvas.getContext("2d");
  pen.fillStyle = walls;
  pen.fillRect(0, 0, width, height);
  for (const { x, y, radius, color, power } of lamps) {
    for (const around of [-width, 0, width]) {
      const glow = pen.createRadialGradient(x + around, y, 0, x + around, y, radius);
      glow.addColorStop(0, `rgb(${color} / ${power})`);
      glow.addColorStop(0.55, `rgb(${color} / ${power})`);
      glow.addColorStop(1, `rgb(${color} / 0)`);
      pen.fillStyle = glow;
      pen.fillRect(0, 0, width, height);
    }
  }
  return canvas.toDataURL("image/png");
}

class ModelPane {
  constructor({ id, label, start, orbit, points }, studio) {
    this.start = start;
    this.points = points;
    this.hotspots = [];
    this.orbit = orbit;
    this.viewer = element("model-viewer", {
      alt: `${label}: animated head, turn it with the mouse or the arrow keys`,
      "camera-controls": true, "touch-action": "pan-y", "interaction-prompt": "none",
      "camera-orbit": orbit, "field-of-view": FIELD_OF_VIEW, "min-field-of-view": "8deg",
      "max-field-of-view": "40deg", "min-camera-orbit": "auto auto 40%",
      "max-camera-orbit": "auto 170deg 300%",
      "environment-image": studio, exposure: STUDIO.exposure, "tone-mapping": "neutral", "shadow-intensity": "0", loading: "eager",
    });
    this.viewer.append(element("div", { slot: "progress-bar" }));
    this.pane = paneOf("model", label, this.viewer);
    this.pane.append(element("button", {
      class: "reset small", type: "button", title: "Look from the front again (F)",
      onclick: () => this.onfront(),
    }, "front"));
    this.ready = this.load(id);
  }

  async load(id) {
    if (!document.createElement("canvas").getContext("webgl2")) {
      this.pane.append(element("p", { class: "trouble" },
        "The model cannot be drawn: WebGL 2 is missing or switched off in this browser."));
    }
    const url = URL.createObjectURL(new Blob([await takeBytes(id)], { type: "model/gltf-binary" }));
    const settled = once(this.viewer, ["load", "error"]);
    this.viewer.src = url;
    const event = await settled;
    URL.revokeObjectURL(url);
    if (event.type === "error") {
      const why = event.detail?.sourceError?.message ?? "it cannot be shown here";
      this.pane.append(element("p", { class: "trouble" }, `The model was not loaded: ${why}`));
      return;
    }
    this.viewer.play(); // binds the animation; the page's clock moves it
    this.viewer.pause();
    this.isMoving = this.viewer.duration > 0;
  }

  async lookFrom(orbit) {
    // what was set before is set again only after something else was
    Object.assign(this.viewer, { cameraOrbit: "auto auto auto", fieldOfView: "auto", cameraTarget: "0m 0m 0m" });
    await this.viewer.updateComplete;
    Object.assign(this.viewer, { cameraOrbit: orbit, fieldOfView: FIELD_OF_VIEW, cameraTarget: "auto auto auto" });
  }

  get end() { return this.isMoving ? this.start + this.viewer.duration : 0; }
  get time() { return this.isMoving ? this.start + this.viewer.currentTime : null; }

  show(time) {
    if (!this.isMoving) return;
    const own = Math.min(Math.max(time - this.start, 0), this.viewer.duration - BEFORE_END_S);
    if (own !== this.viewer.currentTime) this.viewer.currentTime = Math.max(own, 0);
    this.placePoints();
  }

  /** "" for none, "dots", or "names" for dots with their names. */
  showPoints(how) {
    this.pane.dataset.points = how;
    for (const { dot } of this.hotspots) dot.remove();
    this.hotspots = !how ? [] : this.points.map(([name, surface]) => {
      const slot = `hotspot-${name}`;
      const dot = element("div", {
        slot, class: "point", "data-surface": surface, "data-visibility-attribute": "visible",
      }, element("span", {}, name));
      return { slot, surface, dot };
    });
    this.viewer.append(...this.hotspots.map(({ dot }) => dot));
    requestAnimationFrame(() => this.placePoints());
  }

  /** The viewer itself moves points with the surface only while it plays by its own clock. */
  placePoints() {
    for (const { slot, surface } of this.hotspots) this.viewer.updateHotspot({ name: slot, surface });
  }
}

class VideoPane {
  constructor({ id, label, start, type, hasSound }) {
    this.start = start;
    this.video = element("video", {
      playsinline: true, preload: "auto", disablepictureinpicture: true, "aria-label": label,
    });
    this.video.muted = !hasSound;
    this.pane = paneOf("video", label, this.video);
    this.video.addEventListener("seeked", () => this.seekOn());
    this.ready = this.load(id, type);
    this.lastFollowed = -Infinity; // ms
  }

  async load(id, type) {
    const settled = once(this.video, ["loadeddata", "error"]);
    this.video.src = URL.createObjectURL(new Blob([await takeBytes(id)], { type }));
    const event = await settled;
    this.isLoaded = event.type === "loadeddata";
    if (!this.isLoaded) {
      const why = this.video.error?.message ? ` (${this.video.error.message})` : "";
      this.pane.append(element("p", { class: "trouble" },
        `The video cannot be played: this browser seems to lack its codec${why}`));
    }
  }

  get end() { return this.isLoaded ? this.start + this.video.duration : 0; }
  get time() { return this.isLoaded ? this.start + this.video.currentTime : null; }

  own(time) {
    const inside = time - this.start + INSIDE_FRAME_S;
    return Math.min(Math.max(inside, 0), Math.max(this.video.duration - INSIDE_FRAME_S, 0));
  }

  /** Show the frame of a time and hold it. Resolves when it is there. */
  async show(time) {
    if (!this.isLoaded) return;
    this.video.pause();
    this.wanted = this.own(time);
    if (!this.video.seeking) this.seekOn();
    while (this.video.seeking || this.wanted != null) await once(this.video, ["seeked", "error"]);
  }

  seekOn() {
    if (this.wanted == null) return;
    const target = this.wanted;
    this.wanted = null;
    if (Math.abs(this.video.currentTime - target) > 1e-6) this.video.currentTime = target;
  }

  /** Run along with the clock; jump only where more than a frame off. */
  follow(time, speed, frame, now) {
    if (!this.isLoaded) return;
    const own = time - this.start;
    if (own < 0 || own >= this.video.duration) {
      if (!this.video.paused) this.video.pause();
      if (!this.video.seeking && Math.abs(this.video.currentTime - this.own(time)) > frame) {
        this.video.currentTime = this.own(time);
      }
      return;
    }
    this.video.playbackRate = speed;
    const off = this.video.currentTime - own;
    const isStarting = this.video.paused;
    if (isStarting) this.startPlaying();
    const isDue = isStarting || now - this.lastFollowed > FOLLOW_EVERY_MS;
    if (Math.abs(off) > frame && !this.video.seeking && isDue) {
      this.lastFollowed = now;
      this.video.currentTime = this.own(time);
    }
  }

  startPlaying() {
    this.video.play().catch((error) => {
      if (error.name !== "NotAllowedError") return; // a pause that came in between
      this.video.muted = true; // sound waits for a click; the picture need not
      this.video.play().catch(() => {});
    });
  }
}

/** Models that are turned by hand turn together; a press of "front" brings all back. */
function linkViews(models) {
  let isLinked = models.length > 1;
  const front = () => { for (const model of models) model.lookFrom(model.orbit); };
  for (const model of models) {
    model.onfront = () => { if (isLinked) front(); else model.lookFrom(model.orbit); };
    model.viewer.addEventListener("camera-change", (event) => {
      if (!isLinked || event.detail.source !== "user-interaction") return;
      const { theta, phi, radius } = model.viewer.getCameraOrbit();
      const share = radius / model.frontRadius;
      for (const other of models) {
        if (other === model) continue;
        other.viewer.cameraOrbit = `${theta}rad ${phi}rad ${share * other.frontRadius}m`;
        other.viewer.fieldOfView = `${model.viewer.getFieldOfView()}deg`;
        other.viewer.jumpCameraToGoal();
      }
    });
    model.ready.then(() => { model.frontRadius = model.viewer.getCameraOrbit().radius; });
  }
  return { front, get isLinked() { return isLinked; }, toggle: () => { isLinked = !isLinked; } };
}

/** All pictures, side by side. */
function buildStage(config) {
  const videos = config.videos.map((video) => new VideoPane(video));
  const studio = config.models.length ? paintStudio() : null;
  const models = config.models.map((model) => new ModelPane(model, studio));
  const stage = document.getElementById("stage");
  for (const panes of [videos, models]) {
    if (!panes.length) continue;
    const columns = Math.ceil(Math.sqrt(panes.length));
    const share = Math.max(1, columns / Math.ceil(panes.length / columns));
    const style = `--columns: ${columns}; --share: ${share}`;
    stage.append(element("div", { class: "group", style }, ...panes.map((p) => p.pane)));
  }
  stage.hidden = !stage.children.length;
  return { videos, models, views: linkViews(models) };
}
