// The plot under the pointer: seeking, zooming, moving, and the values where it points.

Object.assign(Plot.prototype, {
  listen() {
    const { box } = this;
    const at = (event) => event.clientX - box.getBoundingClientRect().left;
    box.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.isDragging = true;
      this.clock.seek(this.clock.snapped(this.timeAt(at(event))));
      box.setPointerCapture(event.pointerId);
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
      const isZoom = event.ctrlKey || event.metaKey;
      const sideways = event.shiftKey ? event.deltaY || event.deltaX : event.deltaX;
      if (!isZoom && (!this.zoom || !sideways)) return; // a plain wheel scrolls the page
      event.preventDefault();
      if (isZoom) this.zoomBy(event.deltaY < 0 ? 0.8 : 1.25, this.timeAt(at(event)));
      else this.moveBy(Math.sign(sideways) * 0.1);
    }, { passive: false });
  },

  point(x, y) {
    const time = this.clock.snapped(this.timeAt(x));
    this.pointed = time;
    this.hover.hidden = !this.colors.size;
    const rows = [...this.colors.keys()].map((name) => {
      const { unit } = this.set.channels.get(name);
      const values = this.set.valuesAt(name, time);
      const text = values.map((value) => formatValue(value, unit)).join(" | ");
      const angles = values.length === 1 ? inDegrees(values[0], unit) : "";
      return element("div", { style: `--c: ${this.colorOf(name)}` },
        element("i"), name, element("b", {}, `${text} ${unit}${angles}`));
    });
    const frame = this.clock.frameOf(time);
    const when = `${time.toFixed(3)} s${frame === null ? "" : ` · frame ${frame}`}`;
    this.hover.replaceChildren(element("p", {}, when), ...rows);
    const { offsetWidth: w, offsetHeight: h } = this.hover;
    const right = x + 16 + w > this.box.clientWidth ? x - 16 - w : x + 16;
    this.hover.style.left = `${Math.max(right, 0)}px`;
    this.hover.style.top = `${Math.max(0, Math.min(y - h / 2, this.box.clientHeight - h))}px`;
    this.drawCursor();
  },

  zoomBy(factor, about = this.clock.time) {
    const { duration } = this.clock;
    const [from, to] = this.view;
    const span = Math.max((to - from) * factor, Math.min(duration, 0.1));
    if (span >= duration) { this.zoom = null; this.draw(); return; }
    const share = (about - from) / (to - from);
    const start = Math.min(Math.max(about - share * span, 0), duration - span);
    this.zoom = [start, start + span];
    this.draw();
  },

  /** Move a zoomed view by a share of what it shows. */
  moveBy(share) {
    if (!this.zoom) return;
    const span = this.zoom[1] - this.zoom[0];
    const from = Math.min(Math.max(this.zoom[0] + share * span, 0), this.clock.duration - span);
    this.zoom = [from, from + span];
    this.draw();
  },
});
