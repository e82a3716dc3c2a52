// The entries of regions.yaml as shapes with handles. Handles change the entries in place.

const round = (value) => Math.round(value * 10) / 10;
export const rounded = ([x, y]) => [round(x), round(y)];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1];
const plus = (a, ...steps) => steps.reduce(([x, y], [v, s]) => [x + v[0] * s, y + v[1] * s], a);

export function unit(v) {
  const length = Math.hypot(...v);
  return [v[0] / length, v[1] / length];
}

// {key, kind, name, outlines, handles, shift, remove} of each; outlines are lists of points.
export function shapesOf(entries) {
  const shapes = [];
  if (entries.panel) shapes.push(polygon("panel", "panel", "Panel", entries.panel, () => delete entries.panel));
  for (const [kind, word] of [["fixed", "Fixed region"], ["fixed_holes", "Hole"]])
    (entries[kind] || []).forEach((points, i, all) => {
      const name = kind === "fixed_holes" || all.length > 1 ? `${word} ${i + 1}` : word;
      shapes.push(polygon(`${kind}${i}`, kind, name, points, () => {
        all.splice(i, 1);
        if (!all.length) delete entries[kind];
      }));
    });
  if (entries.crack) shapes.push("point" in entries.crack ? fromPoint(entries) : rectangles(entries));
  if (entries.x_axis) shapes.push(axis(entries));
  return shapes;
}

function polygon(key, kind, name, points, remove) {
  const handles = points.map((at, i) => ({
    at,
    name: `corner ${i + 1}`,
    move: (to) => { points[i] = rounded(to); },
    remove: points.length > 3 ? () => points.splice(i, 1) : null,
  }));
  const middles = points.map((at, i) => {
    const next = points[(i + 1) % points.length], middle = [(at[0] + next[0]) / 2, (at[1] + next[1]) / 2];
    const insert = () => {
      points.splice(i + 1, 0, rounded(middle));
      return i + 1;
    };
    return {at: middle, name: `new corner after corner ${i + 1}`, insert};
  });
  return {
    key, kind, name, outlines: [points], closed: true, handles: [...handles, ...middles], remove,
    shift: (by) => points.forEach((at, i) => { points[i] = rounded(plus(at, [by, 1])); }),
  };
}

function fromPoint(entries) {
  const crack = entries.crack, along = unit(crack.direction), normal = [along[1], -along[0]];
  const [across, length] = crack.size, gap = crack.gap || 0;
  const rectangle = (side) => [[gap, -length], [gap + across, -length], [gap + across, length], [gap, length]]
    .map(([n, t]) => plus(crack.point, [normal, side * n], [along, t / 2]));
  const away = (to) => Math.abs(dot(minus(to, crack.point), normal));
  return {
    key: "crack", kind: "crack", name: "Measuring zones", outlines: [rectangle(-1), rectangle(1)], closed: true,
    handles: [
      {at: crack.point, name: "point on the crack", move: (to) => { crack.point = rounded(to); }},
      {
        at: plus(crack.point, [along, length / 2]),
        name: "direction of the crack and length of the zones",
        move: (to) => {
          const arm = minus(to, crack.point), reach = Math.hypot(...arm);
          if (reach < 2) return;
          crack.direction = unit(arm).map((value) => Math.round(value * 1e4) / 1e4);
          crack.size = [crack.size[0], round(2 * reach)];
        },
      },
      {
        at: plus(crack.point, [normal, gap + across]),
        name: "width of the zones",
        move: (to) => { crack.size = [round(Math.max(2, away(to) - gap)), crack.size[1]]; },
      },
      {
        at: plus(crack.point, [normal, -gap], [along, length / 4]),
        name: "gap between the crack and the zones",
        move: (to) => { crack.gap = round(away(to)); },
      },
    ],
    shift: (by) => { crack.point = rounded(plus(crack.point, [by, 1])); },
    remove: () => delete entries.crack,
  };
}

function rectangles(entries) {
  const crack = entries.crack, sides = ["left", "right"];
  const corners = [[0, 1], [2, 1], [2, 3], [0, 3]];
  return {
    key: "crack", kind: "crack", name: "Measuring zones", closed: true,
    outlines: sides.map((side) => corners.map(([i, j]) => [crack[side][i], crack[side][j]])),
    handles: sides.flatMap((side) => corners.map(([i, j], number) => ({
      at: [crack[side][i], crack[side][j]],
      name: `${side} zone, corner ${number + 1}`,
      move: (to) => {
        const box = crack[side], [x, y] = rounded(to);
        box[i] = i === 0 ? Math.min(x, box[2] - 1) : Math.max(x, box[0] + 1);
        box[j] = j === 1 ? Math.min(y, box[3] - 1) : Math.max(y, box[1] + 1);
      },
    }))),
    shift: (by) => sides.forEach((side) => { crack[side] = crack[side].map((v, i) => round(v + by[i % 2])); }),
    remove: () => delete entries.crack,
  };
}

function axis(entries) {
  const points = entries.x_axis;
  return {
    key: "x_axis", kind: "x_axis", name: "x axis", outlines: [points], closed: false,
    handles: points.map((at, i) => ({at, name: i ? "end" : "start", move: (to) => { points[i] = rounded(to); }})),
    shift: (by) => points.forEach((at, i) => { points[i] = rounded(plus(at, [by, 1])); }),
    remove: () => delete entries.x_axis,
  };
}

// What a finished drawing adds to the entries. subset: side of a subset and step of the grid [px].
export function add(entries, tool, points, subset) {
  const drawn = points.map(rounded);
  if (tool === "panel") entries.panel = drawn;
  else if (tool === "x_axis") entries.x_axis = drawn;
  else if (tool === "fixed" || tool === "fixed_holes") (entries[tool] ||= []).push(drawn);
  else if (tool === "point") {
    const arm = minus(points[1], points[0]), along = unit(arm);
    const reach = subset.size / 2 * (Math.abs(along[0]) + Math.abs(along[1]));
    entries.crack = {
      point: drawn[0],
      direction: along.map((value) => Math.round(value * 1e4) / 1e4),
      size: [round(Math.max(Math.hypot(...arm), 3 * subset.step)), round(2 * Math.hypot(...arm))],
      gap: Math.ceil(reach),
    };
  } else if (tool === "rectangles") {
    const boxes = [drawn.slice(0, 2), drawn.slice(2)].map(([a, b]) => [
      Math.min(a[0], b[0]), Math.min(a[1], b[1]), Math.max(a[0], b[0]), Math.max(a[1], b[1]),
    ]);
    const [dx, dy] = [0, 1].map((i) => boxes[1][i] + boxes[1][i + 2] - boxes[0][i] - boxes[0][i + 2]);
    if ((Math.abs(dx) >= Math.abs(dy) ? dx : dy) < 0) boxes.reverse();
    entries.crack = {left: boxes[0], right: boxes[1]};
  }
}
