import type { Unit } from "../units";
import { Store } from "./store";

export type Theme = "auto" | "light" | "dark";
export type Language = "en" | "de";

/** What a person chose, kept in the browser. */
export interface Settings {
  language: Language;
  theme: Theme;
  unit: Unit;
  /** A printer's room in millimetres, by name, or of one's own. */
  printer: string;
  room: [number, number, number];
}

const NAME = "meshmend.settings";

function spoken(): Language {
  return navigator.languages.find((it) => /^(de|en)\b/.test(it))?.startsWith("de") ? "de" : "en";
}

function load(): Settings {
  const first: Settings = { language: spoken(), theme: "auto", unit: "mm", printer: "", room: [220, 220, 250] };
  try {
    return { ...first, ...(JSON.parse(localStorage.getItem(NAME) ?? "{}") as Partial<Settings>) };
  } catch {
    return first;
  }
}

export const settings = new Store<Settings>(load());

settings.listen(() => {
  try {
    localStorage.setItem(NAME, JSON.stringify(settings.value));
  } catch {
    // Kept for this visit only.
  }
});

export function choose(change: Partial<Settings>): void {
  settings.change((now) => ({ ...now, ...change }));
}
