// The newest image with the regions on it. The next one is asked for when this one is there: a slow link shows fewer.

const COLORS = {
  panel: "#f0e442", fixed: "#56b4e9", fixed_holes: "#56b4e9", left: "#e69f00", right: "#e69f00", crack: "#ff7a45",
};
const DASHES = {fixed: [10, 4], fixed_holes: [3, 4], crack: [8, 6]};

export class CameraView {
  constructor(canvas, note) {
    Object.assign(this, {canvas, note, number: -1});
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
    const response = await fetch(`/live/picture?after=${this.number}`);
    if (response.status === 204) {
      this.note.textContent = "No image is being measured.";
      return;
    }
    if (!response.ok) throw new Error(response.status);
    const bytes = new Uint8Array(await response.arrayBuffer()), end = bytes.indexOf(10);
    const about = JSON.parse(new TextDecoder().decode(bytes.subarray(0, end)));
    const image = await createImageBitmap(new Blob([bytes.subarray(end + 1)], {type: "image/jpeg"}));
    this.number = about.number;
    this.draw(image, about);
    image.close();
  }

  draw(image, {width, height, outlines, reason, stamp_ns}) {
    const {canvas} = this, scale = image.width / width, context = canvas.getContext("2d");
    canvas.width = image.width;
    canvas.height = image.height;
    canvas.style.aspectRatio = `${width} / ${height}`;
    canvas.dataset.stamp = stamp_ns;
    canvas.dataset.outlines = JSON.stringify(outlines);
    context.drawImage(image, 0, 0);
    context.setTransform(scale, 0, 0, scale, scale / 2, scale / 2);
    for (const [name, polygons] of Object.entries(outlines))
      for (const points of polygons) {
        context.beginPath();
        for (const [x, y] of points) context.lineTo(x, y);
        if (name !== "crack") context.closePath();
        context.setLineDash([]);
        context.lineWidth = 4.5 / scale;
        context.strokeStyle = "rgba(0, 0, 0, .6)";
        context.stroke();
        context.setLineDash((DASHES[name] || []).map((length) => length / scale));
        context.lineWidth = 2.2 / scale;
        context.strokeStyle = COLORS[name];
        context.stroke();
      }
    this.note.textContent = reason ? `This image: ${reason}.` : "";
  }
}
