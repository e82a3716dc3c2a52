// Draws shapes, their handles and what is being drawn into an SVG element over the image.

const SVG = "http://www.w3.org/2000/svg";

export function node(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

const pathOf = (points, closed) => `M${points.map(([x, y]) => `${x} ${y}`).join("L")}${closed ? "Z" : ""}`;

// A line on a dark one, so that it is seen on any image; the widest, unseen, is to be grasped.
export function outline(points, closed, className) {
  const d = pathOf(points, closed);
  return node("g", {class: className}, ...["grasp", "halo", "line"].map((part) => node("path", {class: part, d})));
}

export class Layer {
  constructor(svg) {
    this.svg = svg;
  }

  // shapes: of shapesOf(); selected: key of the one that shows its handles, or null; draft: what is being drawn; line:
  // that of the crack; letters: [letter, point] of each.
  render({view, shapes, selected, draft, line, letters}) {
    const focused = document.activeElement?.closest?.(".handle")?.id, s = view.scale;
    const group = node("g", {transform: `translate(${view.x} ${view.y}) scale(${s})`});
    if (line) group.append(outline(line, false, "outline shape crackline"));
    for (const shape of shapes) {
      const chosen = shape.key === selected ? " selected" : "";
      const element = node("g", {class: `shape ${shape.kind}${chosen}`, "data-key": shape.key});
      for (const points of shape.outlines) element.append(outline(points, shape.closed, "outline"));
      group.append(element);
    }
    for (const [letter, [x, y]] of letters)
      group.append(node("text", {class: "letter", transform: `translate(${x} ${y}) scale(${1 / s})`, y: 6}, letter));
    for (const shape of shapes) if (shape.key === selected) group.append(...this.handles(shape, s));
    if (draft) group.append(this.draft(draft, s));
    this.svg.replaceChildren(group);
    if (focused) document.getElementById(focused)?.focus({preventScroll: true});
  }

  handles(shape, s) {
    return shape.handles.map((handle, i) => {
      const [x, y] = handle.at, name = `${shape.name}, ${handle.name}`;
      const element = node("g", {
        class: `handle${handle.insert ? " insert" : ""}`, id: `${shape.key}-${i}`, "data-index": i,
        transform: `translate(${x} ${y}) scale(${1 / s})`, tabindex: 0, role: "button",
        "aria-label": handle.insert ? name : `${name}, at ${x.toFixed(1)}, ${y.toFixed(1)}`,
      }, node("circle", {class: "hit", r: 16}), node("circle", {class: "dot", r: handle.insert ? 4 : 7}));
      element.append(node("title", {}, name));
      return element;
    });
  }

  draft({tool, points, cursor}, s) {
    const shown = cursor ? [...points, cursor] : points, group = node("g", {class: `shape draft ${tool}`});
    if (tool === "rectangles")
      for (let i = 0; i + 1 < shown.length; i += 2) {
        const [a, b] = [shown[i], shown[i + 1]];
        group.append(outline([a, [b[0], a[1]], b, [a[0], b[1]]], true, "outline"));
      }
    else if (shown.length > 1) group.append(outline(shown, false, "outline"));
    for (const [x, y] of points) group.append(node("circle", {class: "dot", cx: x, cy: y, r: 5 / s}));
    if (cursor) {
      const [x, y] = cursor, arm = 12 / s;
      const cross = [[[x - arm, y], [x + arm, y]], [[x, y - arm], [x, y + arm]]];
      group.append(...cross.map((points) => outline(points, false, "outline cross")));
    }
    return group;
  }
}
