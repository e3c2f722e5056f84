// Set the dark or light theme before the page is drawn. Reports store the theme under the same key.
{ let theme = null;
  try { theme = localStorage.getItem("aras-report-theme"); } catch { /* no local storage */ }
  document.documentElement.dataset.theme = theme
    || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"); }
