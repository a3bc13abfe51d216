// Making elements, and the data that is embedded.

// A time stamp, rounded, may lie just before its frame. What is named and what is shown must agree,
// so whoever asks for the frame of a time adds this first.
const INSIDE_FRAME_S = 1e-3;

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === false || value == null) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children);
  return made;
}

function icon(path) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  const shape = document.createElementNS("http://www.w3.org/2000/svg", "path");
  shape.setAttribute("d", path);
  svg.append(shape);
  return svg;
}

/**
 * The bytes of an embedded block, unpacked where they are packed; the block is removed to free its
 * text.
 */
async function takeBytes(id) {
  const block = document.getElementById(id);
  const text = block.textContent.trim();
  const packing = block.dataset.packed;
  block.remove();
  const padding = text.endsWith("==") ? 2 : text.endsWith("=") ? 1 : 0;
  const bytes = new Uint8Array((text.length / 4) * 3 - padding);
  const step = 4 * 65536;
  for (let from = 0, to = 0; from < text.length; from += step) {
    const part = atob(text.slice(from, from + step));
    for (let i = 0; i < part.length; i++) bytes[to++] = part.charCodeAt(i);
  }
  if (!packing) return bytes;
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream(packing));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function once(target, names) {
  return new Promise((done) => {
    for (const name of names) target.addEventListener(name, done, { once: true });
  });
}

// Colours of what is drawn on canvases; the page's style sheet has the rest.
const PALETTES = {
  dark: {
    grid: "#23262a", zero: "#454a51", tick: "#8d939b", label: "#747a82", cursor: "#ffffff",
    pointed: "#7b828a", wave: "#5b7d93", range: "rgb(0 0 0 / 45%)",
    series: ["#f0b35c", "#7cc4ff", "#8fd694", "#e88bb4", "#b9a3f5", "#5fd3c6", "#f08a6b",
      "#d9d067", "#9fb4c9", "#c98f5a", "#6f9df0", "#d48fe0"],
  },
  light: {
    grid: "#e6e8eb", zero: "#b4b9c0", tick: "#5b626b", label: "#6b727b", cursor: "#14171a",
    pointed: "#8b929a", wave: "#6f9ab8", range: "rgb(60 70 80 / 16%)",
    series: ["#b45f06", "#0b68b4", "#27803c", "#b02a6b", "#6644c4", "#0a7d74", "#c23f1c",
      "#7d7400", "#48607a", "#8a5522", "#2450c0", "#93309f"],
  },
};

function palette() { return PALETTES[document.documentElement.dataset.theme] ?? PALETTES.dark; }
