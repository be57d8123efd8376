"use strict";
// Each scenario is one player: all its films, its time slider and the cursors in its plots show the
// same moment. A film with a frame for each step shows step k from k * step to (k + 1) * step.
const players = [];

function makePlayer(root) {
  const films = [...root.querySelectorAll("video[data-film]")];
  const cursors = [...root.querySelectorAll(".cursor")];
  const stage = root.querySelector(".player");
  const play = root.querySelector("[data-play]");
  const scrub = root.querySelector("[data-scrub]");
  const clock = root.querySelector("[data-time]");
  const rate = root.querySelector("[data-rate]");
  const camera = root.querySelector("[data-cameras]");
  const end = Number(root.dataset.seconds);
  const step = Number(root.dataset.step);
  let now = 0, last = null;

  const aim = (film) => Math.max(0, Math.min(now + step / 2, (film.duration || end) - step / 4));
  const show = () => {
    scrub.value = now;
    clock.textContent = now.toFixed(1) + " s";
    for (const cursor of cursors) {
      const { left, right, end: reach } = cursor.dataset;
      const share = Number(left) + (Number(right) - Number(left)) * Math.min(now / Number(reach), 1);
      cursor.style.left = (100 * share) + "%";
      cursor.style.display = "block";
    }
  };
  const load = () => {
    for (const film of films) if (film.preload === "none") { film.preload = "auto"; film.load(); }
  };
  const seek = (time) => {
    now = Math.max(0, Math.min(time, end));
    for (const film of films) film.currentTime = aim(film);
    show();
  };
  const pause = () => {
    last = null;
    for (const film of films) film.pause();
    play.textContent = "▶ Play";
    play.setAttribute("aria-label", "Play all videos of this scenario");
  };
  const go = (time) => { pause(); load(); seek(time); };
  const stride = (steps) => go(Math.round(now / step + steps) * step);
  const tick = (stamp) => {
    if (last === null) return;
    now += (stamp - last) / 1000 * Number(rate.value);
    last = stamp;
    if (now >= end) { seek(end); pause(); return; }
    for (const film of films) {
      // A film that ended earlier keeps its last frame; one that drifts is pulled back.
      if (!film.ended && !film.seeking && Math.abs(film.currentTime - aim(film)) > 1.5 * step) film.currentTime = aim(film);
    }
    show();
    requestAnimationFrame(tick);
  };
  const start = () => {
    load();
    seek(now >= end ? 0 : now);
    for (const film of films) { film.playbackRate = Number(rate.value); film.play().catch(() => {}); }
    play.textContent = "❚❚ Pause";
    play.setAttribute("aria-label", "Pause");
    last = performance.now();
    requestAnimationFrame(tick);
  };
  const toggle = () => (last === null ? start() : pause());

  for (const film of films) {
    film.removeAttribute("controls");
    film.addEventListener("click", toggle);
    film.addEventListener("loadedmetadata", () => {
      film.currentTime = aim(film);
      if (last !== null) film.play().catch(() => {});
    });
  }
  const choose = () => {
    for (const place of root.querySelectorAll("[data-camera]"))
      place.hidden = place.dataset.camera !== camera.value;
  };
  if (camera) { camera.addEventListener("change", choose); choose(); }
  play.addEventListener("click", toggle);
  scrub.addEventListener("input", () => go(Number(scrub.value)));
  rate.addEventListener("change", () => { for (const film of films) film.playbackRate = Number(rate.value); });
  for (const button of root.querySelectorAll("[data-jump]"))
    button.addEventListener("click", () => stride(Number(button.dataset.jump)));
  for (const button of root.querySelectorAll("[data-seek]"))
    button.addEventListener("click", () => {
      go(Number(button.dataset.seek));
      if (button.closest(".moments")) stage.scrollIntoView({ behavior: "smooth", block: "nearest" });
    });
  for (const plot of root.querySelectorAll(".plot .canvas"))
    plot.addEventListener("click", (event) => {
      const { left, right, end: reach } = plot.querySelector(".cursor").dataset;
      const box = plot.getBoundingClientRect();
      go(((event.clientX - box.left) / box.width - Number(left)) / (Number(right) - Number(left)) * Number(reach));
    });
  root.querySelector(".controls").hidden = false;
  seek(0);
  // Browsers limit the films of a page: those of a player are loaded when it comes near.
  new IntersectionObserver((seen, observer) => {
    if (seen.some((one) => one.isIntersecting)) { load(); observer.disconnect(); }
  }, { rootMargin: "800px" }).observe(stage);
  return { root, toggle, stride, second: 1 / step };
}

for (const root of document.querySelectorAll("[data-player]"))
  if (Number(root.dataset.seconds) > 0) players.push(makePlayer(root));

// Keys go to the player that has the focus, else to the one of which the window shows most.
function shownMost() {
  const visible = (player) => {
    const box = player.root.getBoundingClientRect();
    return Math.min(box.bottom, innerHeight) - Math.max(box.top, 0);
  };
  const inView = players.filter((player) => visible(player) > 0);
  return inView.sort((a, b) => visible(b) - visible(a))[0];
}
document.addEventListener("keydown", (event) => {
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  if (event.target.closest("input, select, textarea")) return;
  const player = players.find((one) => one.root.contains(document.activeElement)) || shownMost();
  if (!player) return;
  if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
    const steps = event.shiftKey ? player.second : 1;
    player.stride(event.key === "ArrowLeft" ? -steps : steps);
  } else if (event.key === " " && !event.target.closest("button, a, summary")) {
    player.toggle();
  } else return;
  event.preventDefault();
});

if (!matchMedia("(prefers-reduced-motion: reduce)").matches)
  for (const film of document.querySelectorAll("video[data-loop]")) film.play().catch(() => {});
