// The page on which regions are drawn.
import {get, post} from "./ask.js";
import {History} from "./history.js";
import {Layer} from "./layer.js";
import {Pencil} from "./pencil.js";
import {add, shapesOf} from "./shapes.js";
import {showLook, sizeOf, paintSubsets, SIGMA_CLASSES} from "./look.js";
import {View} from "./view.js";

const $ = (id) => document.getElementById(id);
const HINTS = {
  move: "Drag a handle or an outline to move it, the image to pan; the wheel or two fingers zoom.",
  panel: "Click the corners of the panel; click the first one again, or press Enter, to close it.",
  fixed: "Click the corners of the part that does not deform, on one side of the crack; Enter closes it.",
  fixed_holes: "Click the corners of what is to be cut out of the fixed region; Enter closes it.",
  point: "Press on the crack and drag along it: two zones, the same on both sides.",
  rectangles: "Drag one rectangle on each side of the crack.",
  x_axis: "Drag along the panel's x axis, for example along its lower edge.",
};

const history = new History({});
const layer = new Layer($("shapes"));
const page = {
  tool: "move", selected: null, scene: null, look: null,
  shapes: () => shapesOf(history.value),
  edit(change, drag) {
    history.change(change, drag);
    changed();
  },
  finish(tool, points) {
    history.change((entries) => add(entries, tool, points, {size: page.scene.subset_size, step: page.scene.step}));
    page.chooseTool("move");
    const kind = tool === "point" || tool === "rectangles" ? "crack" : tool;
    page.selected = page.shapes().filter((shape) => shape.kind === kind).at(-1)?.key ?? null;
    changed();
  },
  select(key) {
    page.selected = key;
    redraw();
    listShapes();
  },
  chooseTool(tool) {
    page.tool = tool;
    pencil.cancel();
    for (const button of document.querySelectorAll("button[data-tool]"))
      button.setAttribute("aria-pressed", String(button.dataset.tool === tool));
    $("hint").textContent = HINTS[tool];
    $("view").dataset.tool = tool;
  },
  redraw: () => redraw(),
};
page.view = new View($("view"), $("picture"), redraw);
page.view.paint = (context) => {
  if ($("show-subsets").checked && page.look) paintSubsets(context, page.look, page.scene, page.view.scale);
};
const pencil = new Pencil($("view"), page);

function redraw() {
  if (!page.scene) return;
  $("undo").disabled = !history.past.length && !pencil.points.length;
  $("redo").disabled = !history.future.length;
  const shapes = page.shapes();
  layer.render({
    view: page.view, shapes, selected: page.tool === "move" ? page.selected : null, draft: pencil.draft,
    line: crackLine(), letters: zoneLetters(),
  });
}

// The crack's line through the whole image.
function crackLine() {
  const crack = history.value.crack && page.look?.crack;
  if (!crack) return null;
  const reach = Math.hypot(page.scene.width, page.scene.height), [p, d] = [crack.point, crack.direction];
  return [-reach, reach].map((t) => [p[0] + t * d[0], p[1] + t * d[1]]);
}

// Which zone is the left one, as the server sees it.
function zoneLetters() {
  const crack = history.value.crack && page.look?.crack;
  const middle = (points) => [0, 1].map((i) => points.reduce((sum, point) => sum + point[i], 0) / points.length);
  return crack ? [["L", middle(crack.left)], ["R", middle(crack.right)]] : [];
}

function listShapes() {
  const focused = document.activeElement?.id;
  const items = page.shapes().map((shape) => {
    const item = document.createElement("li"), select = document.createElement("button");
    const remove = document.createElement("button"), size = document.createElement("span");
    select.id = `list-${shape.key}`;
    select.textContent = shape.name;
    select.className = `name ${shape.kind}`;
    select.setAttribute("aria-pressed", String(shape.key === page.selected));
    select.onclick = () => {
      page.chooseTool("move");
      page.select(shape.key);
    };
    size.className = "size";
    size.id = `size-${shape.key}`;
    size.textContent = sizeOf(page.look, shape.key);
    select.append(size);
    select.setAttribute("aria-label", shape.name);
    select.setAttribute("aria-describedby", size.id);
    remove.textContent = "✕";
    remove.className = "remove";
    remove.title = `Remove ${shape.name}`;
    remove.setAttribute("aria-label", remove.title);
    remove.onclick = () => page.edit(shape.remove);
    item.append(select, remove);
    return item;
  });
  $("shapes-list").replaceChildren(...items);
  $("nothing").hidden = items.length > 0;
  if (focused?.startsWith("list-")) $(focused)?.focus({preventScroll: true});
}

function changed() {
  if (!page.shapes().some((shape) => shape.key === page.selected)) page.selected = null;
  listShapes();
  redraw();
  say("");
  askForLook();
}

// One question at a time; the last one counts.
let asking = false, again = false;
async function askForLook() {
  ready(false);
  if (asking) {
    again = true;
    return;
  }
  asking = true;
  do {
    again = false;
    const asked = structuredClone(history.value);
    let problem = "";
    try {
      page.look = asked.panel ? await post("/regions/look", {entries: asked}) : null;
    } catch (error) {
      page.look = null;
      problem = error.message;
    }
    if (!again) {
      showLook(page.look, problem, Object.keys(asked).length > 0);
      ready(Boolean(page.look && !page.look.refusals.length));
      listShapes();
      page.view.changed();
    }
  } while (again);
  asking = false;
}

function replaceEntries(others) {
  history.change((entries) => {
    for (const key of Object.keys(entries)) delete entries[key];
    Object.assign(entries, others);
  });
  changed();
}

// What has been drawn since is lost when the page is left: the browser then asks.
let keptText = "{}";
function kept(entries) {
  keptText = JSON.stringify(entries);
}
window.addEventListener("beforeunload", (event) => {
  if (JSON.stringify(history.value) !== keptText) event.preventDefault();
});

function ready(yes) {
  for (const id of ["save", "set"]) $(id).disabled = !yes;
}

function say(words, wrong = false) {
  $("said").textContent = words || `Save writes ${page.scene?.out ?? "regions.yaml"}`;
  $("said").classList.toggle("wrong", wrong);
}

async function ask(path, content) {
  try {
    const answer = await post(path, content);
    say(answer.done || "");
    return answer;
  } catch (error) {
    say(error.message, true);
    return null;
  }
}

async function load() {
  page.scene = await get("/regions/scene");
  const {name, width, height, subset_size, step, noise, live} = page.scene;
  $("source").textContent = `${name}, ${width} × ${height} px`;
  $("grid").textContent = `${subset_size} px every ${step} px, noise ${noise} grey level${noise === 1 ? "" : "s"}`;
  for (const element of document.querySelectorAll(".live-only")) element.hidden = !live;
  const image = new Image();
  image.src = `/regions/image?${Date.now()}`;
  await image.decode();
  page.view.show(image);
}

for (const button of document.querySelectorAll("button[data-tool]"))
  button.onclick = () => page.chooseTool(button.dataset.tool);
$("undo").onclick = () => {
  if (pencil.points.length) {
    pencil.takeBack();
    return;
  }
  history.undo();
  changed();
};
$("redo").onclick = () => { history.redo(); changed(); };
$("zoom-in").onclick = () => page.view.zoom(1.25);
$("zoom-out").onclick = () => page.view.zoom(0.8);
$("fit").onclick = () => page.view.fit();
$("show-subsets").onchange = () => page.view.changed();
for (const what of ["save", "set"]) $(what).onclick = async () => {
  const entries = structuredClone(history.value);
  if (await ask(`/regions/${what}`, {entries})) kept(entries);
};
$("new-image").onclick = async () => {
  const answer = await ask("/regions/new_image", {});
  if (!answer) return;
  await load();
  replaceEntries(page.scene.entries);
  kept(history.value);
  say(answer.done);
};
$("open").onclick = () => $("file").click();
$("file").onchange = async () => {
  const [file] = $("file").files;
  $("file").value = "";
  if (!file) return;
  const answer = await ask("/regions/read", {text: await file.text()});
  if (!answer) return;
  replaceEntries(answer.entries);
  kept(history.value);
  say(`${file.name} is loaded`);
};
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey)) return;
  const key = event.key.toLowerCase();
  if (key === "z" || key === "y") {
    event.preventDefault();
    $(key === "y" || event.shiftKey ? "redo" : "undo").click();
  }
});
$("legend").replaceChildren(...SIGMA_CLASSES.map(({words, color}) => {
  const item = document.createElement("li"), key = document.createElement("span");
  key.className = "key";
  if (color === "none") key.textContent = "×";
  else key.style.background = color;
  item.append(key, words);
  return item;
}));

page.chooseTool("move");
try {
  await load();
  history.reset(page.scene.entries);
  kept(history.value);
  changed();
} catch (error) {
  say(error.message, true);
}
