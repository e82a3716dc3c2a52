// Mouse, fingers and keys on the image: draws with the chosen tool, moves handles, pans.

const NEEDED = {x_axis: 2, point: 2, rectangles: 4};  // points of a tool; the others draw polygons
const STEPS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
const CLOSE = 12, DRAGGED = 6;  // px of the screen

export class Pencil {
  // page: view, image size, shapes(), selected, tool; edit(change), finish(tool, points), select(key), chooseTool(tool),
  // redraw().
  constructor(element, page) {
    Object.assign(this, {element, page, points: [], cursor: null, drag: null, pressed: null});
    for (const name of ["pointerdown", "pointermove", "pointerup", "pointercancel"])
      element.addEventListener(name, (event) => this.pointer(event));
    element.addEventListener("dblclick", (event) => event.preventDefault());
    element.addEventListener("keydown", (event) => this.key(event));
    element.addEventListener("pointerleave", () => this.hover(null));
  }

  get drawing() {
    return this.page.tool !== "move";
  }

  get draft() {
    return this.drawing ? {tool: this.page.tool, points: this.points, cursor: this.cursor} : null;
  }

  cancel() {
    this.points = [];
    this.cursor = null;
    this.page.redraw();
  }

  takeBack() {
    this.points.pop();
    this.page.redraw();
  }

  clamp([x, y]) {
    const {width, height} = this.page.view.image;
    return [Math.min(width - 1, Math.max(0, x)), Math.min(height - 1, Math.max(0, y))];
  }

  pointer(event) {
    const view = this.page.view;
    if (!view.image) return;
    if (view.pinch(event)) {
      if (this.pressed) this.points.pop();  // the first finger's
      this.drag = this.pressed = null;
      return;
    }
    if (event.type === "pointerdown") this.down(event);
    else if (event.type === "pointermove") this.move(event);
    else this.up(event);
  }

  down(event) {
    this.element.setPointerCapture(event.pointerId);
    const at = this.page.view.inView(event), middle = event.button === 1;
    if (this.drawing && !middle) {
      this.pressed = {at, placed: this.place(this.page.view.inImage(event))};
      return;
    }
    const handle = event.target.closest(".handle"), shape = event.target.closest(".shape[data-key]");
    if (handle && !middle) {
      this.grasp(Number(handle.dataset.index), event);
    } else if (shape && !middle) {
      this.page.select(shape.dataset.key);
      this.drag = {kind: "shape", from: this.page.view.inImage(event)};
    } else this.drag = {kind: "pan", from: at};
  }

  grasp(index, event) {
    const handle = this.selected.handles[index];
    this.drag = {kind: "handle", index};
    if (handle.insert) this.page.edit(() => { this.drag.index = handle.insert(); });
    event?.preventDefault();
  }

  get selected() {
    return this.page.shapes().find((shape) => shape.key === this.page.selected);
  }

  move(event) {
    const view = this.page.view, at = view.inImage(event);
    if (this.drawing && !this.drag) {
      this.hover(this.clamp(at));
      return;
    }
    if (!this.drag) return;
    if (this.drag.kind === "pan") {
      const [x, y] = view.inView(event);
      view.pan(x - this.drag.from[0], y - this.drag.from[1]);
      this.drag.from = [x, y];
    } else if (this.drag.kind === "handle") {
      this.page.edit(() => this.selected.handles[this.drag.index].move(this.clamp(at)), this.drag);
    } else {
      const by = [at[0] - this.drag.from[0], at[1] - this.drag.from[1]];
      if (!this.drag.begun && Math.hypot(...by) * view.scale < DRAGGED) return;
      this.page.edit(() => this.selected.shift(by), this.drag);
      this.drag.from = at;
    }
  }

  up(event) {
    const pressed = this.pressed, view = this.page.view;
    this.pressed = this.drag = null;
    if (!pressed || !pressed.placed || !(this.page.tool in NEEDED) || event.type !== "pointerup") return;
    const [x, y] = view.inView(event);
    if (Math.hypot(x - pressed.at[0], y - pressed.at[1]) > DRAGGED) this.place(view.inImage(event));
  }

  hover(cursor) {
    if (!this.drawing) return;
    this.cursor = cursor;
    this.page.redraw();
  }

  // Put a point of the drawing; true if more are wanted.
  place(at) {
    const point = this.clamp(at), tool = this.page.tool, near = CLOSE / this.page.view.scale;
    const close = (other) => Math.hypot(other[0] - point[0], other[1] - point[1]) < near;
    if (tool in NEEDED) {
      if (this.points.length % 2 && close(this.points.at(-1))) return true;
      this.points.push(point);
      if (this.points.length === NEEDED[tool]) return this.finish();
    } else if (this.points.length && (close(this.points[0]) || close(this.points.at(-1)))) {
      return this.finish();
    } else this.points.push(point);
    this.cursor = point;
    this.page.redraw();
    return true;
  }

  finish() {
    const {points} = this, tool = this.page.tool;
    if (points.length < (NEEDED[tool] || 3)) return true;
    this.points = [];
    this.cursor = null;
    this.page.finish(tool, points);
    return false;
  }

  key(event) {
    const step = STEPS[event.key], size = event.altKey ? 0.1 : event.shiftKey ? 10 : 1;
    const handle = event.target.closest(".handle");
    let done = true;
    if (step && handle) {
      const index = Number(handle.dataset.index), {at, move} = this.selected.handles[index];
      if (move) this.page.edit(() => move(this.clamp([at[0] + step[0] * size, at[1] + step[1] * size])));
    } else if (handle && (event.key === "Delete" || event.key === "Backspace")) {
      const {remove} = this.selected.handles[Number(handle.dataset.index)];
      if (remove) this.page.edit(remove);
    } else if (handle && (event.key === "Enter" || event.key === " ")) {
      const {insert} = this.selected.handles[Number(handle.dataset.index)];
      if (insert) this.page.edit(insert);
    } else if (step && this.drawing) {
      const {width, height} = this.page.view.image, from = this.cursor || [(width - 1) / 2, (height - 1) / 2];
      this.hover(this.clamp([from[0] + step[0] * size, from[1] + step[1] * size].map(Math.round)));
    } else if (step) this.page.view.pan(-step[0] * 4 * size, -step[1] * 4 * size);
    else if (event.key === " " && this.drawing && this.cursor) this.place(this.cursor);
    else if (event.key === "Enter" && this.drawing) this.finish();
    else if (event.key === "Backspace" && this.drawing) this.takeBack();
    else if (event.key === "Escape") {
      if (this.points.length) this.cancel();
      else this.page.chooseTool("move");
    } else if (event.key === "Delete" && this.selected) this.page.edit(this.selected.remove);
    else if (event.key === "+" || event.key === "=") this.page.view.zoom(1.25);
    else if (event.key === "-") this.page.view.zoom(0.8);
    else if (event.key === "0") this.page.view.fit();
    else done = false;
    if (done) {
      event.preventDefault();
      event.stopPropagation();
    }
  }
}
