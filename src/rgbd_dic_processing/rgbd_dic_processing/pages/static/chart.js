// Strip charts on a canvas: openings over time, with what was not valid and what was marked.

const INK = "#16202a", SOFT = "#4a5763", GRID = "#dbe1e6", LINE = "#0b5c94", BAND = "rgba(11, 92, 148, .22)";
const INVALID = "#c4431c", EVENT = "#7a5200";
const LEFT = 56, RIGHT = 12, TOP = 8, BOTTOM = 24;

export class Chart {
  constructor(canvas) {
    this.canvas = canvas;
    new ResizeObserver(() => this.redraw && this.redraw()).observe(canvas);
  }

  // Times from..to [s], values low..high [mm]; then draw(context, x, y) in between.
  frame(from, to, low, high, events, draw) {
    const {canvas} = this, ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const context = canvas.getContext("2d"), bottom = height - BOTTOM;
    context.scale(ratio, ratio);
    if (!(high - low > 1e-4)) [low, high] = [low - 0.01, high + 0.01];
    const margin = (high - low) * 0.08;
    [low, high] = [low - margin, high + margin];
    const x = (t) => LEFT + (t - from) / (to - from) * (width - LEFT - RIGHT);
    const y = (v) => bottom - (v - low) / (high - low) * (bottom - TOP);
    context.font = "13px system-ui, sans-serif";
    context.lineWidth = 1;
    context.textAlign = "right";
    context.textBaseline = "middle";
    const step = nice((high - low) / 4), digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let v = Math.ceil(low / step) * step; v <= high; v += step) {
      line(context, GRID, [[LEFT, y(v)], [width - RIGHT, y(v)]]);
      context.fillStyle = SOFT;
      context.fillText(v.toFixed(digits), LEFT - 7, y(v));
    }
    context.textAlign = "center";
    context.textBaseline = "top";
    const every = nice((to - from) / 6);
    for (let t = Math.ceil(from / every) * every; t <= to; t += every) {
      line(context, GRID, [[x(t), TOP], [x(t), bottom]]);
      if (t >= 0) context.fillText(`${+t.toFixed(2)} s`, Math.min(Math.max(x(t), LEFT + 8), width - 24), bottom + 6);
    }
    context.save();
    context.beginPath();
    context.rect(LEFT, 0, width - LEFT - RIGHT, bottom);
    context.clip();
    draw(context, x, y, bottom);
    context.setLineDash([5, 4]);
    for (const {time, text} of events) {
      line(context, EVENT, [[x(time), TOP], [x(time), bottom]], 1.5);
      context.fillStyle = EVENT;
      context.textAlign = "left";
      context.fillText(text.slice(0, 24), x(time) + 4, TOP);
    }
    context.restore();
    line(context, INK, [[LEFT, TOP], [LEFT, bottom], [width - RIGHT, bottom]]);
  }

  // samples: [time, opening, u]; opening null where it is not valid.
  minute(samples, events) {
    this.redraw = () => this.minute(samples, events);
    const newest = samples.at(-1)?.[0] ?? 0, from = Math.max(newest - 60, samples[0]?.[0] ?? 0), to = Math.max(newest, from + 2);
    const valid = samples.filter(([, value]) => value !== null);
    const low = Math.min(...valid.map(([, v, u]) => v - (u || 0))), high = Math.max(...valid.map(([, v, u]) => v + (u || 0)));
    this.frame(from, to, valid.length ? low : 0, valid.length ? high : 0, events, (context, x, y, bottom) => {
      for (const run of runs(samples)) {
        const upper = run.map(([t, v, u]) => [x(t), y(v + u)]), lower = run.map(([t, v, u]) => [x(t), y(v - u)]);
        context.fillStyle = BAND;
        context.fill(path([...upper, ...lower.reverse()]));
        line(context, LINE, run.map(([t, v]) => [x(t), y(v)]), 2);
      }
      context.fillStyle = INVALID;
      for (const [t, value] of samples) if (value === null) context.fillRect(x(t) - 1, bottom - 7, 2, 7);
    });
  }

  // overview: low and high of each bin of time up to `end`, and which share of it is not valid.
  flight(overview, events) {
    this.redraw = () => this.flight(overview, events);
    const {end, low, high, invalid} = overview, bins = low.length || 1;
    const lows = low.filter((v) => v !== null), highs = high.filter((v) => v !== null);
    const to = Math.max(end, 1);
    this.frame(0, to, lows.length ? Math.min(...lows) : 0, highs.length ? Math.max(...highs) : 0, events, (context, x, y, bottom) => {
      const centre = (i) => (i + 0.5) / bins * to, middle = [];
      context.fillStyle = BAND;
      for (let i = 0; i < bins; i++) {
        const wide = Math.max(1.5, x(to / bins) - x(0));
        if (low[i] != null) {
          context.fillRect(x(centre(i)) - wide / 2, y(high[i]) - 1, wide, Math.max(2, y(low[i]) - y(high[i]) + 2));
          middle.push([x(centre(i)), y((low[i] + high[i]) / 2)]);
        }
        if (invalid[i] > 0) {
          context.fillStyle = INVALID;
          context.fillRect(x(centre(i)) - wide / 2, bottom - 7 * invalid[i], wide, 7 * invalid[i]);
          context.fillStyle = BAND;
        }
      }
      line(context, LINE, middle, 1.5);
    });
  }
}

function runs(samples) {
  const found = [[]];
  for (const sample of samples) {
    if (sample[1] === null || (found.at(-1).length && sample[0] - found.at(-1).at(-1)[0] > 1)) found.push([]);
    if (sample[1] !== null) found.at(-1).push(sample);
  }
  return found.filter((run) => run.length);
}

function path(points) {
  const shape = new Path2D();
  points.forEach(([x, y], i) => (i ? shape.lineTo(x, y) : shape.moveTo(x, y)));
  return shape;
}

function line(context, color, points, width = 1) {
  if (!points.length) return;
  context.strokeStyle = color;
  context.lineWidth = width;
  context.stroke(path(points));
}

function nice(step) {
  const power = 10 ** Math.floor(Math.log10(step)), share = step / power;
  return power * (share <= 1 ? 1 : share <= 2 ? 2 : share <= 5 ? 5 : 10);
}
