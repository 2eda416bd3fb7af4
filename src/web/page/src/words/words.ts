import { useMemo } from "preact/hooks";
import { Figures } from "../units";
import type { Language } from "../state/settings";
import { settings } from "../state/settings";
import { useStore } from "../views/use-store";
import { de } from "./de";
import { type Words, en } from "./en";

export const LANGUAGES: Record<Language, Words> = { en, de };

/** The texts and the way of writing numbers of the chosen language. */
export function useWords(): { words: Words; figures: Figures } {
  const { language } = useStore(settings);
  return useMemo(() => ({ words: LANGUAGES[language], figures: new Figures(language) }), [language]);
}
