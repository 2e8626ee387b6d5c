// Names and levels that a reader by ear needs, and movies of the gallery over their thumbnails while
// these are pointed at or have the focus.
const still = matchMedia("(prefers-reduced-motion: reduce)");
addEventListener("load", () => {
  for (const e of document.querySelectorAll("article pre, article table, .math-block"))
    if (e.scrollWidth > e.clientWidth) e.tabIndex = 0;  // scrolled by the keyboard, too
});
addEventListener("DOMContentLoaded", () => {
  for (const e of document.querySelectorAll(".caption[role=heading]")) e.ariaLevel = 2;
  document.querySelector(".sidebar-drawer")?.setAttribute("aria-label", "Pages");
  document.querySelector(".toc-drawer")?.setAttribute("aria-label", "On this page");
  for (const a of document.querySelectorAll(".sphx-glr-thumbcontainer a"))
    a.setAttribute("aria-label", a.textContent.trim());
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
