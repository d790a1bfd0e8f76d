// Code or a table that is wider than its place can be reached and scrolled by keyboard, and what the theme
// leaves without a name has one.
function name() {
  document.querySelectorAll(".md-typeset pre > code, .md-typeset__scrollwrap").forEach((item) => {
    if (item.scrollWidth > item.clientWidth) item.tabIndex = 0;
  });
  document.querySelectorAll(".md-code__nav").forEach((nav, k) => nav.setAttribute("aria-label", `Code ${k + 1}`));
  document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
  document.body.dataset.named = "yes";
}
addEventListener("load", name);
addEventListener("resize", name);
