// The list of channels, grouped by region of the face, with a search field; and all about curves.

function buildPicker(set, plot) {
  const boxes = new Map();
  const groups = new Map(set.regions.map((region) => [region, []]));
  for (const channel of set.channels.values()) {
    const box = element("input", {
      type: "checkbox", onchange: (event) => plot.toggle(channel.name, event.target.checked),
    });
    const row = element("label", { title: channel.title }, box, element("span", {}, channel.name), element("i"));
    boxes.set(channel.name, { box, row });
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
      const shown = rows.filter(({ channel }) => plot.colors.has(channel.name)).length;
      count.textContent = shown ? `${shown} of ${rows.length}` : `${rows.length}`;
    }
  };
  const recolor = () => {
    for (const [name, { box, row }] of boxes) {
      box.checked = plot.colors.has(name);
      if (box.checked) row.style.setProperty("--c", plot.colorOf(name));
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
      fold.open = words.length ? here > 0 : rows.some(({ channel }) => plot.colors.has(channel.name));
      found += here;
    }
    none.hidden = found > 0;
  };
  plot.onchange = () => { recolor(); recount(); };
  const search = element("input", {
    type: "search", placeholder: "Search channels (/)", "aria-label": "Search channels",
    oninput: (event) => filter(event.target.value),
    onkeydown: (event) => { if (event.key === "Escape") event.target.blur(); },
  });
  const clear = element("button", {
    type: "button", class: "small", title: "Hide all curves",
    onclick: () => { for (const name of [...plot.colors.keys()]) plot.toggle(name, false); },
  }, "clear");
  const picker = element("aside", { class: "picker", "aria-label": "Channels" },
    element("div", { class: "picker-head" }, search, clear),
    element("div", { class: "picker-list" }, ...folds.map((f) => f.fold), none));
  return { picker, search, refresh: () => { recolor(); recount(); filter(""); } };
}

/** The plot with its list of channels; null where there is nothing to plot. */
async function buildCurves(config, clock) {
  const clips = await Promise.all(config.clips.map((clip) => Curves.load(clip)));
  const wave = config.sound ? new Wave(config.sound, await takeBytes("sound-peaks")) : null;
  if (!clips.length && !wave) return null;
  const set = new CurveSet(clips, config.regions);
  const plot = new Plot(set, wave, clock);
  const zooms = element("div", { class: "cluster", role: "group", "aria-label": "Zoom in time" },
    element("button", { type: "button", class: "small", "aria-label": "Zoom out", title: "Zoom out (−)", onclick: () => plot.zoomBy(2) }, "−"),
    element("button", { type: "button", class: "small", "aria-label": "Zoom in", title: "Zoom in (+, also Ctrl + wheel)", onclick: () => plot.zoomBy(0.5) }, "+"),
    element("button", { type: "button", class: "small", title: "Show the whole clip (0)", onclick: () => plot.zoomBy(Infinity) }, "fit"));
  const panel = element("div", { class: "plot-panel" },
    element("div", { class: "plot-head" }, plot.legend, zooms), plot.box);
  const section = document.getElementById("curves");
  section.append(panel);
  let search = null, recolor = () => {};
  if (clips.length) {
    const made = buildPicker(set, plot);
    section.append(made.picker);
    search = made.search;
    recolor = plot.onchange;
    for (const name of config.shown) plot.toggle(name, true);
    made.refresh();
  } else {
    section.classList.add("sound-only");
  }
  plot.drawLegend();
  section.hidden = false;
  const redraw = () => { plot.drawLegend(); recolor(); plot.draw(); plot.follow(); };
  return { set, plot, wave, search, redraw };
}
