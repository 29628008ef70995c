// Equations: MathJax from this folder, and only where a page has one.
window.MathJax = {
  tex: {
    inlineMath: [["\\(", "\\)"]],
    displayMath: [["\\[", "\\]"]],
    packages: { "[-]": ["autoload", "require"] },
  },
  svg: { fontCache: "global" },
  options: {
    enableMenu: false,
    ignoreHtmlClass: ".*|",
    processHtmlClass: "arithmatex",
  },
};
(() => {
  const source = new URL("vendor/mathjax-3.2.2-tex-svg.js", document.currentScript.src);
  const load = () => {
    if (!document.querySelector(".arithmatex")) return;
    const script = document.createElement("script");
    script.src = source.href;
    document.head.appendChild(script);
  };
  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", load);
  else load();
})();
