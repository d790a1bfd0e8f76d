// Code that is wider than its place can be reached and scrolled by keyboard, and what the theme
// leaves without a name has one.
function name() {
  document.querySelectorAll(".md-typeset pre > code").forEach((code) => {
    if (code.scrollWidth > code.clientWidth) code.tabIndex = 0;
  });
  document.querySelectorAll(".md-code__nav").forEach((nav, k) => nav.setAttribute("aria-label", `Code ${k + 1}`));
  document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
  document.body.dataset.named = "yes";
}
addEventListener("load", name);
addEventListener("resize", name);
