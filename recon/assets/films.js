// Films that keep step with the scene, whose times the switches of the legend pass on.
(function () {
  "use strict";
  const films = Array.from(document.querySelectorAll("#recon-films video"));
  let time = 0, told = -Infinity, pace = 1;

  function place(film) {
    return (time + Number(film.dataset.offset)) * Number(film.dataset.speed);
  }

  // a film that plays may be off by a little, since every jump costs it a moment
  function settle(film, slack) {
    const wanted = Math.max(0, Math.min(place(film), (film.duration || Infinity) - 0.001));
    if (Math.abs(film.currentTime - wanted) > slack) film.currentTime = wanted;
  }

  window.addEventListener("recon-time", (event) => {
    const now = performance.now(), passed = (now - told) / 1000, step = event.detail - time;
    const plays = passed < 0.3 && step > 0 && step < 1;
    if (plays) pace += 0.1 * (Math.min(4, Math.max(0.1, step / Math.max(passed, 0.001))) - pace);
    time = event.detail;
    told = now;
    for (const film of films) {
      if (plays && film.paused && place(film) < film.duration) film.play().catch(() => {});
      if (!film.paused)
        film.playbackRate = Math.min(4, Math.max(0.1, pace * Number(film.dataset.speed)));
      settle(film, film.paused ? 0.01 : 0.12);
    }
  });
  setInterval(() => {
    if (performance.now() - told < 400) return;
    pace = 1;
    for (const film of films) {
      if (!film.paused) film.pause();
      settle(film, 0.01);
    }
  }, 200);
})();
