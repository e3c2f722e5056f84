// Set the dark or light theme before the page is drawn, and let the button `theme` change it. All pages store the theme
// under the same key. After a change, the document dispatches the event "themechange".
{ const KEY = "aras-report-theme", root = document.documentElement;
  let theme = null;
  try { theme = localStorage.getItem(KEY); } catch { /* no local storage */ }
  root.dataset.theme = theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  const other = () => root.dataset.theme === "dark" ? "light" : "dark";
  addEventListener("DOMContentLoaded", () => {
    const button = document.getElementById("theme");
    const showOther = () => { button.textContent = other() === "dark" ? "Dark" : "Light"; };
    button.addEventListener("click", () => {
      root.dataset.theme = other();
      try { localStorage.setItem(KEY, root.dataset.theme); } catch { /* no local storage */ }
      document.dispatchEvent(new Event("themechange"));
    });
    document.addEventListener("themechange", showOther);
    showOther();
  }); }
