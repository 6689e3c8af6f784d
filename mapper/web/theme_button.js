// The button that goes from the system's colours to light, to dark, and back; theme.js does it.

const NAMES = { auto: "auto, as the system", light: "light", dark: "dark" };

export function startThemeButton() {
  const button = document.getElementById("theme");
  const show = () => {
    const choice = document.documentElement.dataset.themeChoice;
    document.getElementById("theme-name").textContent = choice;
    button.setAttribute("aria-label", `Colours: ${NAMES[choice]}`);
  };
  button.addEventListener("click", () => document.dispatchEvent(new Event("themechoice")));
  document.addEventListener("themechange", show);
  show();
}
