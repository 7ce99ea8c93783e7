// Light or dark theme: the system's, until the user switches it with the button.

const KEY = "bendtrack/theme";

export function startTheme(button) {
  apply(localStorage.getItem(KEY));
  button.addEventListener("click", () => {
    const dark = getComputedStyle(document.documentElement).getPropertyValue("--is-dark").trim() === "1";
    const theme = dark ? "light" : "dark";
    localStorage.setItem(KEY, theme);
    apply(theme);
  });
}

function apply(theme) {
  if (theme) document.documentElement.dataset.theme = theme;
}
