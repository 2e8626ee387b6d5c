// Movies of the gallery play over their thumbnails while these are pointed at or have the focus.
const still = matchMedia("(prefers-reduced-motion: reduce)");
addEventListener("DOMContentLoaded", () => {
  for (const name of ["movie", "light_pattern"]) {
    const link = document.querySelector(`.sphx-glr-thumbcontainer a[href^="${name}.html"]`);
    if (!link) continue;
    const box = link.closest(".sphx-glr-thumbcontainer");
    const play = () => {
      if (still.matches || box.querySelector("video")) return;
      const video = document.createElement("video");
      Object.assign(video, { src: `../${name}.mp4`, muted: true, loop: true, autoplay: true });
      video.setAttribute("aria-hidden", "true");
      box.append(video);
    };
    const stop = () => box.querySelector("video")?.remove();
    box.addEventListener("pointerenter", play);
    box.addEventListener("focusin", play);
    box.addEventListener("pointerleave", stop);
    box.addEventListener("focusout", stop);
  }
});
