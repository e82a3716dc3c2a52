// The image with zoom and pan. Coordinates are pixels of the image; (0, 0) is the centre of the first one.

export class View {
  constructor(element, canvas, onChange) {
    Object.assign(this, {element, canvas, onChange, scale: 1, x: 0, y: 0, image: null, paint: null});
    this.fingers = new Map();
    new ResizeObserver(() => this.resized()).observe(element);
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), this.inView(event));
    }, {passive: false});
  }

  show(image) {
    this.image = image;
    this.fit();
  }

  get size() {
    return [this.element.clientWidth, this.element.clientHeight];
  }

  resized() {
    const ratio = window.devicePixelRatio || 1, [width, height] = this.size;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    if (this.image && !this.moved) this.fit();
    else this.changed();
  }

  fit() {
    const [width, height] = this.size;
    this.scale = Math.min(width / this.image.width, height / this.image.height) || 1;
    this.x = (width - (this.image.width - 1) * this.scale) / 2;
    this.y = (height - (this.image.height - 1) * this.scale) / 2;
    this.moved = false;
    this.changed();
  }

  zoom(factor, [x, y] = this.size.map((length) => length / 2)) {
    const scale = Math.min(40, Math.max(0.1, this.scale * factor)), change = scale / this.scale;
    this.x = x - (x - this.x) * change;
    this.y = y - (y - this.y) * change;
    this.scale = scale;
    this.moved = true;
    this.changed();
  }

  pan(dx, dy) {
    this.x += dx;
    this.y += dy;
    this.moved = true;
    this.changed();
  }

  // Two fingers zoom and pan; true while they do.
  pinch(event) {
    const before = [...this.fingers.values()];
    if (event.type === "pointerup" || event.type === "pointercancel") this.fingers.delete(event.pointerId);
    else if (event.buttons) this.fingers.set(event.pointerId, this.inView(event));
    const now = [...this.fingers.values()];
    if (now.length !== 2 || before.length !== 2) return now.length > 1 || before.length > 1;
    const middle = ([a, b]) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    const apart = ([a, b]) => Math.max(1, Math.hypot(a[0] - b[0], a[1] - b[1]));
    this.pan(middle(now)[0] - middle(before)[0], middle(now)[1] - middle(before)[1]);
    this.zoom(apart(now) / apart(before), middle(now));
    return true;
  }

  inView(event) {
    const box = this.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  inImage(event) {
    const [x, y] = this.inView(event);
    return [(x - this.x) / this.scale, (y - this.y) / this.scale];
  }

  changed() {
    if (!this.image || this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = null;
      this.draw();
      this.onChange();
    });
  }

  draw() {
    const context = this.canvas.getContext("2d"), ratio = window.devicePixelRatio || 1;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.setTransform(ratio * this.scale, 0, 0, ratio * this.scale, ratio * this.x, ratio * this.y);
    context.imageSmoothingEnabled = this.scale < 3;
    context.drawImage(this.image, -0.5, -0.5);
    if (this.paint) this.paint(context);
  }
}
