// Light or dark, before anything is drawn. A plain script and no module: modules run after the first picture, which would flash.
// `<html data-theme>` is always "light" or "dark"; `data-theme-choice` is what was chosen: auto, light or dark.

(() => {
  const KEY = "biobot.theme";
  const CHOICES = ["auto", "light", "dark"];
  const system = matchMedia("(prefers-color-scheme: dark)");
  const root = document.documentElement;

  function recall() {
    try {
      return localStorage.getItem(KEY);
    } catch {
      return null; // the browser keeps nothing for this page
    }
  }

  function apply(choice) {
    root.dataset.themeChoice = CHOICES.includes(choice) ? choice : "auto";
    root.dataset.theme = root.dataset.themeChoice === "auto" ? (system.matches ? "dark" : "light") : root.dataset.themeChoice;
    document.dispatchEvent(new Event("themechange"));
  }

  apply(recall());
  system.addEventListener("change", () => apply(root.dataset.themeChoice));
  document.addEventListener("themechoice", () => {
    const next = CHOICES[(CHOICES.indexOf(root.dataset.themeChoice) + 1) % CHOICES.length];
    try {
      localStorage.setItem(KEY, next);
    } catch {
      // then it holds until the page is closed
    }
    apply(next);
  });
})();
