import type { Unit } from "../units";
import { type Language, firstSupported } from "../words/locale";
import { Store } from "./store";

export type Theme = "auto" | "light" | "dark";

/** The user's choices, kept in the browser. */
export interface Settings {
  language: Language;
  theme: Theme;
  unit: Unit;
  /** The printer by name, and the build volume in millimetres. */
  printer: string;
  room: [number, number, number];
  /** The name of the printing process to check new models against; empty for none. */
  process: string;
}

const NAME = "meshmend.settings";

function load(): Settings {
  const first: Settings = { language: firstSupported(navigator.languages), theme: "auto", unit: "mm", printer: "", room: [220, 220, 250], process: "" };
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
    // Without storage, the choices last for this visit only.
  }
});

export function choose(change: Partial<Settings>): void {
  settings.change((now) => ({ ...now, ...change }));
}
