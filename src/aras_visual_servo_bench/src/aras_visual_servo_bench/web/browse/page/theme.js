// Dark or light, before anything is drawn; the report keeps the same choice.
{ let theme = null;
  try { theme = localStorage.getItem("aras-report-theme"); } catch { /* nowhere to keep it */ }
  document.documentElement.dataset.theme = theme
    || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"); }
