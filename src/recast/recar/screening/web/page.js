"use strict";

const AHEAD = 4; // targets whose pictures are fetched before they are shown
const HELD = 24; // targets whose pictures are kept
const CHUNK = 40; // ids fetched at once
const POLL_MS = 4000;
const COLUMNS = ["front", "left", "rear", "right"]; // of a contact sheet, around the vehicle
const ROWS = 3; // pictures, with captions; the target; the target 45 degrees further on
const GAP = 5; // pixels between tiles
const CHOICES = ["show", "order", "lowest", "highest"];
const DONE = { accept: "accepted", reject: "rejected" };
const KEYS = {
  a: "accept", arrowright: "accept", r: "reject", arrowleft: "reject", u: "undo", backspace: "undo",
  s: "skip", " ": "skip", arrowdown: "skip", p: "back", arrowup: "back", n: "next", g: "search",
};

const $ = (id) => document.getElementById(id);
let about; // what the server says of the cache
let items = []; // a stretch of the order; `at` may be one past its end
let at = 0;
let revision = 0;
const pictures = new Map(); // id -> {sheet, sides}

// ---- the server

async function ask(path, options) {
  let response;
  try {
    response = await fetch(path, options);
  } catch {
    $("lost").hidden = false;
    throw new Error("not saved: the server does not answer");
  }
  $("lost").hidden = true;
  const answer = await response.json();
  if (answer.changes) hear(answer);
  if (!response.ok) throw new Error(answer.error);
  return answer;
}

function chosen() {
  const query = { since: revision };
  for (const name of CHOICES) if ($(name).value !== "") query[name] = $(name).value;
  return query;
}

const get = (path, more) => ask(`${path}?${new URLSearchParams({ ...chosen(), ...more })}`);

const post = (path, more) =>
  ask(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ ...chosen(), ...more }),
  });

// What was decided since the last answer, on this page or another.
function hear(answer) {
  if (answer.revision < revision) location.reload(); // the decisions were begun again
  revision = answer.revision;
  for (const [id, decision] of Object.entries(answer.changes)) {
    for (const item of items) if (item.id === id) item.decision = decision;
  }
  showCounts(answer.counts);
  if (items[at] && items[at].id in answer.changes) draw();
}

// ---- the stretch of the order

const fits = (item) => {
  const show = $("show").value;
  if (show === "undecided") return item.decision === null;
  if (show === "decided") return item.decision !== null;
  return show === "all" || item.decision === show;
};

const fetching = new WeakMap(); // stretch -> what is on its way for it
function extend() {
  const stretch = items;
  if (!fetching.has(stretch)) {
    fetching.set(stretch, fetchMore(stretch).finally(() => fetching.delete(stretch)));
  }
  return fetching.get(stretch);
}

async function fetchMore(stretch) {
  const last = stretch.at(-1);
  const { items: found } = await get("/api/items", { limit: CHUNK, ...(last && { after: last.id }) });
  stretch.push(...found);
  return found.length;
}

async function restart() {
  items = [];
  at = 0;
  await extend();
  await show();
}

async function jump(id) {
  const place = items.findIndex((item) => item.id === id);
  if (place < 0) items = (await get("/api/items", { at: id })).items;
  at = Math.max(place, 0);
  await show();
}

async function forward() {
  if (at < items.length) at += 1;
  while (at < items.length || (await extend())) {
    // Others may have decided since the stretch was fetched.
    if ($("show").value !== "undecided" || fits(items[at])) break;
    at += 1;
  }
  await show();
}

async function backward() {
  if (at === 0 && items.length) {
    const before = (await get("/api/items", { limit: CHUNK, before: items[0].id })).items;
    items.unshift(...before);
    at = before.length;
  }
  if (at === 0) return say("this is the first one", true);
  at -= 1;
  await show();
}

async function nextUndecided() {
  const here = items[Math.min(at, items.length - 1)];
  const wanted = { show: "undecided", limit: 1 };
  let found = here ? (await get("/api/items", { ...wanted, after: here.id })).items : [];
  if (!found.length) found = (await get("/api/items", wanted)).items;
  if (!found.length) return say("nothing undecided within these scores");
  await jump(found[0].id);
}

// ---- what the keys do

async function decide(decision) {
  const item = items[at];
  if (!item) return say("nothing to decide here", true);
  await post("/api/decide", { id: item.id, decision });
  say(`${item.id} ${DONE[decision]}`);
}

const acts = {
  async accept() {
    await decide("accept");
    await forward();
  },
  async reject() {
    await decide("reject");
    await forward();
  },
  async undo() {
    const { undone } = await post("/api/undo", {});
    if (undone === null) return say("nothing left to undo");
    await jump(undone);
    say(`${undone}: undone, now ${items[at].decision ?? "undecided"}`);
  },
  skip: forward,
  back: backward,
  next: nextUndecided,
  search: () => $("search").select(),
};

// One after the other, in the order of the key presses.
let queue = Promise.resolve();
function act(what) {
  queue = queue.then(() => say("")).then(what).catch((error) => say(error.message, true));
  return queue;
}

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape") return document.activeElement.blur();
  if (event.target.matches("input, select")) return;
  const name = KEYS[event.key.toLowerCase()];
  if (!name) return;
  event.preventDefault();
  // A key held down walks on, but decides once.
  if (!event.repeat || name === "skip" || name === "back") act(acts[name]);
});

for (const button of document.querySelectorAll("[data-act]")) {
  button.addEventListener("click", () => {
    button.blur(); // or the space bar would press it again
    act(acts[button.dataset.act]);
  });
}

for (const name of CHOICES) {
  $(name).addEventListener("change", () => {
    $(name).blur();
    const { since, ...kept } = chosen();
    history.replaceState(null, "", `?${new URLSearchParams(kept)}`);
    act(restart);
  });
}

$("search").addEventListener("input", async () => {
  const { ids } = await get("/api/search", { text: $("search").value }).catch(() => ({ ids: [] }));
  $("found").replaceChildren(...ids.map((id) => new Option(id)));
});

$("go").addEventListener("submit", (event) => {
  event.preventDefault();
  const text = $("search").value.trim();
  act(async () => {
    const { ids } = await get("/api/search", { text });
    if (!ids.length) throw new Error(`no id holds “${text}”`);
    if (!ids.includes(text) && ids.length > 1) throw new Error(`several ids hold “${text}”`);
    $("search").value = "";
    $("search").blur();
    await jump(ids.includes(text) ? text : ids[0]);
  });
});

// ---- what is seen

function fetchPicture(id, kind) {
  const image = new Image();
  image.alt = kind;
  image.src = `/picture/${encodeURIComponent(id)}/${kind}`;
  image.ready = image.decode().then(() => true, () => false);
  return image;
}

function picturesOf(id) {
  if (!pictures.has(id)) {
    const sides = about.sides.map((side) => fetchPicture(id, side));
    pictures.set(id, { sheet: fetchPicture(id, "turntable"), sides });
    if (pictures.size > HELD) pictures.delete(pictures.keys().next().value);
  }
  return pictures.get(id);
}

async function show() {
  const item = items[at];
  if (item) await picturesOf(item.id).sheet.ready;
  draw();
  for (const next of items.slice(at + 1, at + 1 + AHEAD)) picturesOf(next.id);
  if (items.length - at <= AHEAD) extend().catch(() => {});
}

function draw() {
  const item = items[at];
  $("main").classList.toggle("done", !item);
  $("empty").hidden = Boolean(item);
  if (!item) {
    const all = $("progress").getAttribute("aria-valuemax");
    $("empty").textContent = $("progress").getAttribute("aria-valuenow") === all
      ? `All ${all} targets within these scores are decided. U takes back the last decision; choose `
        + "what to show above to look at them again."
      : $("show").value === "undecided"
      ? "No more undecided targets from here on within these scores. N goes to those that were "
        + "skipped, U takes back the last decision, P goes back."
      : "No more targets from here on. P goes back, or choose what to show above.";
    $("facts").replaceChildren();
    return;
  }
  const { sheet, sides } = picturesOf(item.id);
  $("turntable").className = item.decision ?? "";
  $("badge").textContent = item.decision ? DONE[item.decision] : "undecided";
  // The pictures first, since they take their room from the sheet.
  $("inputs").replaceChildren(...sides.map((image) => figure(image, `picture: ${image.alt}`)));
  drawSheet(sheet);
  const number = (value) => (value === null ? "none" : value.toFixed(2));
  const facts = [`${about.score ?? "score"} ${number(item.score)}`];
  if (item.turned !== null) {
    const exchanged = item.turned > item.score;
    facts.push(`rear to front ${number(item.turned)}${exchanged ? ": better, exchanged?" : ""}`);
  }
  facts.push([item.colour, item.kind].filter(Boolean).join(" "), `${item.voxels} voxels`, item.split);
  const name = document.createElement("b");
  name.textContent = item.id;
  $("facts").replaceChildren(name, ...facts.map((text) => {
    const span = document.createElement("span");
    span.textContent = text;
    return span;
  }));
}

function figure(content, caption) {
  const made = document.createElement("figure");
  const words = document.createElement("figcaption");
  words.textContent = caption;
  made.append(content, ...(caption ? [words] : []));
  return made;
}

function drawSheet(sheet) {
  const box = $("sheet");
  const width = sheet.naturalWidth / COLUMNS.length;
  const height = sheet.naturalHeight / ROWS;
  if (!width) {
    const missing = document.createElement("p");
    missing.textContent = "This target has no contact sheet.";
    box.replaceChildren(missing);
    return;
  }
  box.replaceChildren(); // so that its size is that of the space there is
  const room = box.getBoundingClientRect();
  const scale = Math.min(
    (room.width - GAP * (COLUMNS.length - 1)) / COLUMNS.length / width,
    (room.height - GAP * (ROWS - 1)) / ROWS / height,
  );
  box.style.fontSize = `${Math.max(12, 12 * scale)}px`; // hides the captions within the tiles
  box.style.gap = `${GAP}px`;
  box.style.gridTemplateColumns = `repeat(${COLUMNS.length}, max-content)`;
  for (let row = 0; row < ROWS; row += 1) {
    for (let column = 0; column < COLUMNS.length; column += 1) {
      const tile = document.createElement("canvas");
      tile.width = width;
      tile.height = height;
      tile.style.width = `${Math.floor(width * scale)}px`;
      tile.getContext("2d").drawImage(
        sheet, column * width, row * height, width, height, 0, 0, width, height,
      );
      box.append(figure(tile, row === 1 ? `target: ${COLUMNS[column]}` : ""));
    }
  }
}

function showCounts(counts) {
  const decided = counts.all - counts.undecided;
  const bar = $("progress");
  bar.setAttribute("aria-valuemax", counts.all);
  bar.setAttribute("aria-valuenow", decided);
  for (const part of bar.children) {
    part.style.width = `${(100 * counts[part.className]) / Math.max(counts.all, 1)}%`;
  }
  const words = { accept: "accepted", reject: "rejected" };
  const parts = [`${decided} of ${counts.all} decided`];
  for (const [name, word] of Object.entries(words)) {
    const part = document.createElement("b");
    part.className = name;
    part.textContent = `${counts[name]} ${word}`;
    parts.push(" · ", part);
  }
  const outside = about.total - counts.all;
  if (outside) parts.push(` · ${outside} outside these scores`);
  $("counts").replaceChildren(...parts);
}

function say(text, warn = false) {
  $("said").textContent = text;
  $("said").classList.toggle("warn", warn);
}

// ---- begin

async function begin() {
  about = await ask("/api/state");
  revision = about.revision;
  document.title = `Screening ${about.cache}`;
  $("cache").textContent = about.cache;
  $("score-name").textContent = about.score ?? "score";
  const asked = new URLSearchParams(location.search);
  $("lowest").value = about.threshold ?? "";
  $("order").value = about.score === null ? "id" : "lowest";
  if (asked.size) for (const name of CHOICES) $(name).value = asked.get(name) ?? "";
  await restart();
  setInterval(() => get("/api/news").catch(() => {}), POLL_MS);
}

window.addEventListener("resize", () => about && draw());
act(begin);
