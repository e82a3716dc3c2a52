// Shows what the server says of the regions: subsets by their expected uncertainty, sizes, what cannot work.

export const SIGMA_CLASSES = [
  {words: "up to 0.01 px", below: 0.01, color: "#2166ac"},
  {words: "up to 0.02 px", below: 0.02, color: "#67a9cf"},
  {words: "up to 0.05 px", below: 0.05, color: "#fdae61"},
  {words: "more: poor texture", below: Infinity, color: "#b2182b"},
  {words: "none: not found", below: null, color: "none"},
];
const SIZES = {
  "distance": "Distance", "pixel": "Pixel", "between zone centres": "Zones apart",
};
const COUNTS = {panel: "Panel", fixed: "Fixed region", left: "Left zone", right: "Right zone"};

export function paintSubsets(context, look, scene, scale) {
  const {x, y, sigma, zone} = look.subsets, side = Math.min(scene.step * 0.55, 14), half = side / 2;
  context.lineWidth = Math.max(1 / scale, 0.3);
  for (let i = 0; i < x.length; i++) {
    if (sigma[i] === null) {
      for (const [color, width] of [["#000", 3], ["#fff", 1.4]]) {
        context.strokeStyle = color;
        context.lineWidth = width / scale;
        context.beginPath();
        context.moveTo(x[i] - half, y[i] - half);
        context.lineTo(x[i] + half, y[i] + half);
        context.moveTo(x[i] + half, y[i] - half);
        context.lineTo(x[i] - half, y[i] + half);
        context.stroke();
      }
      continue;
    }
    context.globalAlpha = zone[i] ? 0.95 : 0.6;
    context.fillStyle = SIGMA_CLASSES.find(({below}) => below !== null && sigma[i] <= below).color;
    context.fillRect(x[i] - half, y[i] - half, side, side);
    context.globalAlpha = 1;
  }
}

export function showLook(look, problem, begun) {
  const refusals = problem ? [problem] : look ? look.refusals : begun ? ["draw the panel first"] : [];
  list("refusals", refusals);
  list("warnings", look ? look.warnings : []);
  const fine = look && !refusals.length;
  document.getElementById("verdict").textContent =
    fine ? "These regions can be measured." : refusals.length ? "This cannot work yet:" : "Begin with the panel.";
  document.getElementById("verdict").classList.toggle("fine", Boolean(fine));
  const counts = Object.entries(COUNTS).filter(([key]) => look?.counts[key][0]).map(([key, words]) => {
    const [all, textured] = look.counts[key];
    return [words, textured === all ? `${all}` : `${textured} of ${all} have texture`];
  });
  rows("counts", counts);
  const sizes = Object.entries(SIZES).filter(([key]) => look?.sizes_mm[key] != null).map(([key, words]) =>
    [words, `${look.sizes_mm[key].toFixed(key === "pixel" ? 3 : key === "distance" ? 0 : 1)} mm`]);
  if (look?.u_opening_mm != null) sizes.push(["Noise of one opening", `${look.u_opening_mm.toFixed(4)} mm`]);
  else if (look?.u_opening_px != null)
    sizes.push(["Noise of one opening", `${look.u_opening_px.toFixed(4)} px`]);
  rows("sizes", sizes);
  document.getElementById("no-sizes").textContent = look?.no_sizes ? `No sizes in mm: ${look.no_sizes}.` : "";
}

// The size of a drawn shape on the panel; empty as long as it is not known.
export function sizeOf(look, key) {
  const known = look?.sizes_mm ?? {}, mm = (...names) => names.map((name) => known[name]?.toFixed(0)).join(" × ");
  if (key === "x_axis") return known["x axis"] == null ? "" : `${mm("x axis")} mm`;
  if (key === "crack") {
    if (known["left zone across"] == null) return "";
    const sides = ["left", "right"].map((side) => [known[`${side} zone across`], known[`${side} zone along`]]);
    const means = [0, 1].map((i) => (sides[0][i] + sides[1][i]) / 2);
    const words = (lengths) => lengths.map((length) => length.toFixed(0)).join(" × ");
    return sides[0].every((length, i) => Math.abs(length - means[i]) < 0.03 * means[i])  // but for the perspective
      ? `${words(means)} mm` : `${sides.map(words).join(", ")} mm`;
  }
  return known[`${key} width`] == null ? "" : `${mm(`${key} width`, `${key} height`)} mm`;
}

function list(id, words) {
  const element = document.getElementById(id);
  element.hidden = !words.length;
  element.replaceChildren(...words.map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  }));
}

function rows(id, pairs) {
  document.getElementById(id).replaceChildren(...pairs.flatMap(([name, value]) => {
    const term = document.createElement("dt"), detail = document.createElement("dd");
    term.textContent = name;
    if (name.length > 15 || value.length > 12) term.className = "long";
    detail.textContent = value;
    return [term, detail];
  }));
}
