// Typeset the formulas of a page, which docs/conf.py writes as LaTeX text. An invalid formula is shown in red.
for (const element of document.querySelectorAll(".math")) {
  katex.render(element.textContent, element, {
    displayMode: element.classList.contains("display"),
    throwOnError: false,
  });
}
