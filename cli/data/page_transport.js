// Buttons and keys.

const ICONS = {
  play: "M7 4.5v15l13-7.5z",
  pause: "M6 4.5h4.2v15H6zm7.8 0H18v15h-4.2z",
  back: "M15.5 5v14L6 12zM18 5h-2v14h2z",
  on: "M8.5 5v14l9.5-7zM6 5h2v14H6z",
  start: "M5 5h2.2v14H5zM19 5v14L8.5 12z",
  loop: "M17 3.5 21.5 7 17 10.5V8.2H8.5A3.5 3.5 0 0 0 5 11.7v.8H2.8v-.8A5.7 5.7 0 0 1 8.5 6H17zM7 20.5 2.5 17 7 13.5v2.3h8.5a3.5 3.5 0 0 0 3.5-3.5v-.8h2.2v.8a5.7 5.7 0 0 1-5.7 5.7H7z",
  sound: "M4 9v6h4l5 4.5v-15L8 9zm11.5-.8v7.6a4.3 4.3 0 0 0 0-7.6zm0-4.2v2.2a6.2 6.2 0 0 1 0 11.6V20a8.3 8.3 0 0 0 0-16z",
  mute: "M4 9v6h4l5 4.5v-15L8 9zm17.5.4L20.1 8l-2.1 2.1L15.9 8l-1.4 1.4 2.1 2.1-2.1 2.1 1.4 1.4 2.1-2.1 2.1 2.1 1.4-1.4-2.1-2.1z",
  points: "M6 8a2 2 0 1 0 0-4 2 2 0 0 0 0 4m12 0a2 2 0 1 0 0-4 2 2 0 0 0 0 4m-6 6a2 2 0 1 0 0-4 2 2 0 0 0 0 4m-5 6a2 2 0 1 0 0-4 2 2 0 0 0 0 4m10 0a2 2 0 1 0 0-4 2 2 0 0 0 0 4",
  theme: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18m0 2.2v13.6a6.8 6.8 0 0 1 0-13.6",
};
const POINT_MODES = ["", "dots", "names"];

function toggleButton(label, path, onclick) {
  return element("button", { type: "button", "aria-label": label, title: label, onclick }, icon(path));
}

function swapIcon(button, path, label) {
  button.replaceChildren(icon(path));
  button.setAttribute("aria-label", label);
  button.title = label;
}

/** Everything a key or a button may do. */
function actionsOf({ clock, models, views, curves, pageTools }) {
  const media = clock.leader?.media ?? null;
  let points = 0;
  return {
    toggle: () => clock.toggle(),
    step: (frames) => clock.step(frames),
    jump: (seconds) => clock.seek(clock.time + seconds),
    start: () => clock.seek(clock.begin),
    end: () => clock.seek(clock.finish),
    loop: () => clock.setLooping(!clock.isLooping),
    setIn: () => clock.setIn(),
    setOut: () => clock.setOut(),
    whole: () => clock.setRange(null, null),
    speed: (factor) => clock.setSpeed(Number((clock.speed * factor).toPrecision(3))),
    mute: () => { if (media) media.muted = !media.muted; },
    front: () => views.front(),
    link: () => { views.toggle(); clock.changed(); },
    points: () => {
      points = (points + 1) % POINT_MODES.length;
      for (const model of models) model.showPoints(POINT_MODES[points]);
      clock.changed();
    },
    get pointMode() { return POINT_MODES[points]; },
    zoom: (factor) => curves?.plot.zoomBy(factor),
    search: () => curves?.search?.focus(),
    ...pageTools,
  };
}

/** Keys, what they are called, and what they do; `when` tells whether they make sense here. */
function keyTable(a, has) {
  return [
    { keys: [" ", "k"], name: "space", text: "play or pause", run: () => a.toggle() },
    { keys: ["ArrowLeft", ","], name: "←", text: "a frame back; with shift a second", run: (e) => (e.shiftKey ? a.jump(-1) : a.step(-1)) },
    { keys: ["ArrowRight", "."], name: "→", text: "a frame on; with shift a second", run: (e) => (e.shiftKey ? a.jump(1) : a.step(1)) },
    { keys: ["Home"], name: "home", text: "to the start", run: () => a.start() },
    { keys: ["End"], name: "end", text: "to the end", run: () => a.end() },
    { keys: ["l"], name: "L", text: "play again and again, or once", run: () => a.loop() },
    { keys: ["i"], name: "I", text: "play from here", run: () => a.setIn() },
    { keys: ["o"], name: "O", text: "play to here", run: () => a.setOut() },
    { keys: ["x"], name: "X", text: "play the whole again", run: () => a.whole() },
    { keys: ["["], name: "[", text: "slower", run: () => a.speed(1 / 1.25) },
    { keys: ["]"], name: "]", text: "faster", run: () => a.speed(1.25) },
    { keys: ["m"], name: "M", text: "sound on or off", when: has.sound, run: () => a.mute() },
    { keys: ["f"], name: "F", text: "look from the front", when: has.models, run: () => a.front() },
    { keys: ["v"], name: "V", text: "turn the heads together or one by one", when: has.several, run: () => a.link() },
    { keys: ["p"], name: "P", text: "points: none, dots, names", when: has.points, run: () => a.points() },
    { keys: ["+", "="], name: "+", text: "zoom the curves in", when: has.plot, run: () => a.zoom(0.5) },
    { keys: ["-"], name: "−", text: "zoom the curves out", when: has.plot, run: () => a.zoom(2) },
    { keys: ["0"], name: "0", text: "the curves' whole length", when: has.plot, run: () => a.zoom(Infinity) },
    { keys: ["/"], name: "/", text: "find a channel by name", when: has.curves, run: () => a.search() },
    { keys: ["t"], name: "T", text: "light or dark", run: () => a.theme() },
    { keys: ["?", "h"], name: "?", text: "this list", run: () => a.help() },
  ].filter(({ when }) => when !== false);
}

function listenToKeys(table) {
  const actions = new Map(table.flatMap(({ keys, run }) => keys.map((key) => [key, run])));
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { target } = event;
    if (target.matches?.("input[type=search], input[type=number]")) return;
    // a focused model turns with the arrow keys, a button or check box works with the space bar
    if (target.matches?.("model-viewer") && event.key.startsWith("Arrow")) return;
    if (event.key === " " && target.matches?.("button, summary, input[type=checkbox]")) return;
    const action = actions.get(event.key) ?? actions.get(event.key.toLowerCase());
    if (!action) return;
    event.preventDefault();
    action(event);
  }, { capture: true });
}

/** The list of keys, as a dialog. */
function buildHelp(table) {
  const rows = table.map(({ name, text }) => element("div", {},
    element("dt", {}, element("kbd", {}, name)), element("dd", {}, text)));
  const close = element("button", { type: "button", class: "small", onclick: () => dialog.close() }, "close");
  const dialog = element("dialog", { class: "help", "aria-label": "Keyboard shortcuts" },
    element("h2", {}, "Keys"), element("dl", {}, ...rows),
    element("p", {}, "Drag a head to turn it, scroll on it to come nearer. Drag along the curves to "
      + "seek; Ctrl + wheel zooms them, Shift + wheel moves a zoomed view."), close);
  dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
  document.body.append(dialog);
  return () => { if (dialog.open) dialog.close(); else dialog.showModal(); };
}

function buildTransport(clock, actions, has) {
  const media = clock.leader?.media ?? null;
  const play = toggleButton("Play (space)", ICONS.play, () => actions.toggle());
  play.classList.add("play");
  const loop = toggleButton("Loop (L)", ICONS.loop, () => actions.loop());
  const speeds = SPEEDS.map((speed) => element("button", {
    type: "button", onclick: () => clock.setSpeed(speed), "aria-label": `Speed ${speed}`,
  }, `${speed}×`));
  const anySpeed = element("input", {
    type: "number", min: SLOWEST, max: FASTEST, step: "0.05", "aria-label": "Speed",
    title: `Any speed from ${SLOWEST} to ${FASTEST} ([ and ])`,
    onchange: (event) => { clock.setSpeed(event.target.valueAsNumber); clock.changed(); },
  });
  const words = (text, title, run) => element("button", { type: "button", class: "small", title, onclick: run }, text);
  const setIn = words("in", "Play from here (I)", () => actions.setIn());
  const setOut = words("out", "Play to here (O)", () => actions.setOut());
  const whole = words("whole", "Play the whole again (X)", () => actions.whole());
  const seconds = element("b"), frames = element("span"), total = element("span");
  const seek = element("input", {
    type: "range", class: "seek", min: "0", step: "any", value: "0", "aria-label": "Time",
    oninput: (event) => clock.seek(clock.snapped(Number(event.target.value))),
  });
  const tools = element("div", { class: "cluster tools" });
  const link = words("together", "Turn the heads together (V)", () => actions.link());
  const points = toggleButton("Feature points: none, dots, names (P)", ICONS.points, () => actions.points());
  if (has.several) tools.append(link);
  if (has.points) tools.append(points);
  tools.append(toggleButton("Light or dark (T)", ICONS.theme, () => actions.theme()),
    element("button", { type: "button", "aria-label": "Keys (?)", title: "Keys (?)", onclick: () => actions.help() }, "?"));
  const parts = [
    element("div", { class: "cluster" },
      toggleButton("To the start (home)", ICONS.start, () => actions.start()),
      toggleButton("One frame back (←)", ICONS.back, () => actions.step(-1)), play,
      toggleButton("One frame on (→)", ICONS.on, () => actions.step(1)), loop),
    element("div", { class: "cluster speeds", role: "group", "aria-label": "Speed" }, ...speeds, anySpeed),
    element("div", { class: "cluster range", role: "group", "aria-label": "In and out" }, setIn, setOut, whole),
    element("div", { class: "clock" }, seconds, total, frames), seek, tools,
  ];
  if (media) {
    const sound = toggleButton("Sound off (M)", ICONS.sound, () => actions.mute());
    sound.dataset.role = "sound";
    media.addEventListener("volumechange", () => swapIcon(sound, media.muted ? ICONS.mute : ICONS.sound,
      media.muted ? "Sound on (M)" : "Sound off (M)"));
    parts.splice(3, 0, sound);
  }
  const pressed = (button, isOn) => button.setAttribute("aria-pressed", isOn);
  const refresh = () => {
    swapIcon(play, clock.isPlaying ? ICONS.pause : ICONS.play, clock.isPlaying ? "Pause (space)" : "Play (space)");
    pressed(loop, clock.isLooping);
    speeds.forEach((button, i) => pressed(button, SPEEDS[i] === clock.speed));
    anySpeed.value = clock.speed;
    pressed(setIn, clock.inPoint !== null);
    pressed(setOut, clock.outPoint !== null);
    whole.disabled = clock.inPoint === null && clock.outPoint === null;
    setIn.textContent = clock.inPoint === null ? "in" : `in ${clock.inPoint.toFixed(2)}`;
    setOut.textContent = clock.outPoint === null ? "out" : `out ${clock.outPoint.toFixed(2)}`;
    pressed(points, actions.pointMode !== "");
    pressed(link, actions.isLinked());
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
