// The newest image with the regions on it. The next one is asked for when this one is there: a slow link shows fewer, and
// coarser ones.

const COLORS = {
  panel: "#f0e442", fixed: "#56b4e9", fixed_holes: "#56b4e9", left: "#e69f00", right: "#e69f00", crack: "#ff7a45",
};
const SLOW_S = 0.5, FAST_S = 0.1, COARSEST = 2;  // that a picture is on its way; how often it may be halved
const DASHES = {fixed: [10, 4], fixed_holes: [3, 4], crack: [8, 6]};

export class CameraView {
  constructor(canvas, note) {
    Object.assign(this, {canvas, note, number: -1, coarse: 0});
    this.follow();
  }

  async follow() {
    for (;;) {
      try {
        if (document.hidden) await new Promise((done) => document.addEventListener("visibilitychange", done, {once: true}));
        await this.next();
      } catch {
        this.number = -1;
        await new Promise((done) => setTimeout(done, 1000));
      }
    }
  }

  async next() {
    const response = await fetch(`/live/picture?after=${this.number}&coarse=${this.coarse}`);
    if (response.status === 204) {
      this.note.textContent = "No image is being measured.";
      return;
    }
    if (!response.ok) throw new Error(response.status);
    const begun = performance.now(), bytes = new Uint8Array(await response.arrayBuffer()), end = bytes.indexOf(10);
    this.adapt((performance.now() - begun) / 1000);
    const about = JSON.parse(new TextDecoder().decode(bytes.subarray(0, end)));
    const image = await createImageBitmap(new Blob([bytes.subarray(end + 1)], {type: "image/jpeg"}));
    this.number = about.number;
    this.draw(image, about);
    image.close();
  }

  adapt(took) {
    if (took > SLOW_S) this.coarse = Math.min(this.coarse + 1, COARSEST);
    else if (took < FAST_S) this.coarse = Math.max(this.coarse - 1, 0);
  }

  draw(image, {width, height, outlines, reason, stamp_ns}) {
    const {canvas} = this, context = canvas.getContext("2d");
    const shown = Math.min(canvas.clientWidth, canvas.clientHeight * width / height) || image.width;
    const scale = Math.max(image.width, shown * (window.devicePixelRatio || 1)) / width, pixel = width / shown;
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    canvas.style.aspectRatio = `${width} / ${height}`;
    canvas.dataset.stamp = stamp_ns;
    canvas.dataset.pixels = image.width;
    canvas.dataset.outlines = JSON.stringify(outlines);
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    context.setTransform(scale, 0, 0, scale, scale / 2, scale / 2);
    for (const [name, polygons] of Object.entries(outlines))
      for (const points of polygons) {
        context.beginPath();
        for (const [x, y] of points) context.lineTo(x, y);
        if (name !== "crack") context.closePath();
        context.setLineDash([]);
        context.lineWidth = 4.5 * pixel;
        context.strokeStyle = "rgba(0, 0, 0, .6)";
        context.stroke();
        context.setLineDash((DASHES[name] || []).map((length) => length * pixel));
        context.lineWidth = 2.4 * pixel;
        context.strokeStyle = COLORS[name];
        context.stroke();
      }
    const coarse = this.coarse ? "The link is slow: the picture is coarse. " : "";
    this.note.textContent = coarse + (reason ? `This image: ${reason}.` : "");
  }
}
