"use strict";
// Each scenario is one player: all its films, its time slider and the cursors in its plots show the
// same moment. A film with a frame for each step shows step k from k * step to (k + 1) * step.
for (const player of document.querySelectorAll("[data-player]")) {
  const films = [...player.querySelectorAll("video[data-film]")];
  const cursors = [...player.querySelectorAll(".cursor")];
  const controls = player.querySelector(".controls");
  const play = player.querySelector("[data-play]");
  const scrub = player.querySelector("[data-scrub]");
  const clock = player.querySelector("[data-time]");
  const rate = player.querySelector("[data-rate]");
  const end = Number(player.dataset.seconds);
  const step = Number(player.dataset.step);
  if (!(end > 0)) continue;
  let now = 0, last = null;

  const aim = (film, time) => Math.max(0, Math.min(time + step / 2, (film.duration || end) - step / 4));
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
  const seek = (time) => {
    now = Math.max(0, Math.min(time, end));
    for (const film of films) film.currentTime = aim(film, now);
    show();
  };
  const pause = () => {
    last = null;
    for (const film of films) film.pause();
    play.textContent = "▶ Play";
    play.setAttribute("aria-label", "Play all films of this scenario");
  };
  const tick = (stamp) => {
    if (last === null) return;
    now += (stamp - last) / 1000 * Number(rate.value);
    last = stamp;
    if (now >= end) { seek(end); pause(); return; }
    for (const film of films) {
      // A film that ended earlier keeps its last frame; one that drifts is pulled back.
      if (!film.ended && Math.abs(film.currentTime - aim(film, now)) > 1.5 * step) film.currentTime = aim(film, now);
    }
    show();
    requestAnimationFrame(tick);
  };
  const start = () => {
    seek(now >= end ? 0 : now);
    for (const film of films) { film.playbackRate = Number(rate.value); film.play().catch(() => {}); }
    play.textContent = "❚❚ Pause";
    play.setAttribute("aria-label", "Pause");
    last = performance.now();
    requestAnimationFrame(tick);
  };

  for (const film of films) {
    film.removeAttribute("controls");
    film.addEventListener("click", () => play.click());
    film.addEventListener("loadedmetadata", () => { if (last === null) film.currentTime = aim(film, now); });
  }
  play.addEventListener("click", () => (last === null ? start() : pause()));
  scrub.addEventListener("input", () => { pause(); seek(Number(scrub.value)); });
  rate.addEventListener("change", () => { for (const film of films) film.playbackRate = Number(rate.value); });
  for (const button of player.querySelectorAll("[data-jump]"))
    button.addEventListener("click", () => { pause(); seek(Math.round(now / step + Number(button.dataset.jump)) * step); });
  for (const button of player.querySelectorAll("[data-seek]"))
    button.addEventListener("click", () => { pause(); seek(Number(button.dataset.seek)); });
  for (const plot of player.querySelectorAll(".plot .canvas"))
    plot.addEventListener("click", (event) => {
      const { left, right, end: reach } = plot.querySelector(".cursor").dataset;
      const box = plot.getBoundingClientRect();
      pause();
      seek(((event.clientX - box.left) / box.width - Number(left)) / (Number(right) - Number(left)) * Number(reach));
    });
  controls.hidden = false;
  seek(0);
}
if (!matchMedia("(prefers-reduced-motion: reduce)").matches)
  for (const film of document.querySelectorAll("video[data-loop]")) film.play().catch(() => {});
