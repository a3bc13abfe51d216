// Puts the page together.

/** Light or dark: as the system has it until the reader chooses. */
function chooseTheme(onchange) {
  const root = document.documentElement;
  const system = window.matchMedia("(prefers-color-scheme: light)");
  let chosen = null;
  const apply = () => {
    root.dataset.theme = chosen ?? (system.matches ? "light" : "dark");
    document.querySelector("meta[name=color-scheme]").content = root.dataset.theme;
    onchange();
  };
  system.addEventListener("change", apply);
  apply();
  return () => { chosen = root.dataset.theme === "light" ? "dark" : "light"; apply(); };
}

function say(text) { document.getElementById("status").textContent = text; }

async function main() {
  const config = JSON.parse(document.getElementById("config").textContent);
  let curves = null, help = () => {};
  const theme = chooseTheme(() => curves?.redraw());
  if (typeof DecompressionStream === "undefined") {
    document.querySelector("main").prepend(element("p", { class: "notice" },
      "This browser is too old to unpack what is on this page: it needs one of 2023 or later."));
    return null;
  }
  const clock = new Clock();
  const { videos, models, views } = buildStage(config);
  clock.videos = videos;
  [curves, clock.leader] = await Promise.all([buildCurves(config, clock), leaderOf(config, videos)]);
  clock.frames = framesOf(config, curves?.set.clips[0]);
  const panes = [...videos, ...models];
  const isTimed = panes.length > 0 || curves !== null;
  clock.followers = models.map((model) => (time) => model.show(time));
  if (curves) clock.followers.push(() => curves.plot.follow());
  document.body.classList.toggle("has-curves", curves !== null);
  document.body.classList.toggle("has-sound-only", curves !== null && !config.clips.length);
  if (isTimed) {
    const has = {
      sound: clock.leader !== null, models: models.length > 0, several: models.length > 1,
      points: models.some((model) => model.points.length > 0), plot: curves !== null,
      curves: curves?.search != null,
    };
    const pageTools = { theme, help: () => help(), isLinked: () => views.isLinked };
    const actions = actionsOf({ clock, models, views, curves, pageTools });
    const table = keyTable(actions, has);
    help = buildHelp(table);
    const transport = buildTransport(clock, actions, has);
    clock.onchange = () => { transport.refresh(); curves?.plot.draw(); };
    clock.followers.push(transport.follow);
    listenToKeys(table);
    document.getElementById("keys").hidden = false;
  }
  const measure = () => {
    const ends = [curves?.set.end ?? 0, curves?.wave?.end ?? 0, ...panes.map((pane) => pane.end)];
    clock.duration = Math.max(0, ...ends);
    clock.changed();
    curves?.plot.draw();
    clock.show();
  };
  measure();
  await Promise.all(panes.map((pane) => pane.ready));
  measure();
  await clock.seek(0);
  say("ready");
  return { clock, videos, models };
}

const made = main();
/** The page as a script sees it; everything but `ready` once that is done. */
window.facewright = {
  ready: made.then(() => {}),
  seek: async (time) => (await made).clock.seek(time),
  play: async () => (await made).clock.play(),
  pause: async () => (await made).clock.pause(),
  setSpeed: async (speed) => (await made).clock.setSpeed(speed),
  setRange: async (from, to) => (await made).clock.setRange(from, to),
};
made.then((page) => {
  if (!page) return;
  const { clock, videos, models } = page;
  window.facewright.time = () => clock.current();
  window.facewright.state = () => ({
    time: clock.current(), frame: clock.frameOf(clock.time), duration: clock.duration,
    playing: clock.isPlaying, speed: clock.speed, looping: clock.isLooping,
    inPoint: clock.inPoint, outPoint: clock.outPoint, leading: clock.leader?.state ?? null,
    soundTime: clock.leader?.media.currentTime ?? null,
    videoTime: videos[0]?.time ?? null, modelTime: models[0]?.time ?? null,
  });
});
