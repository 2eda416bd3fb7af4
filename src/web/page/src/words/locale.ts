import { createContext } from "preact";
import { useContext } from "preact/hooks";
import { Figures } from "../units";
import { de } from "./de";
import { type Words, en } from "./en";

export type Language = "en" | "de";
export const LANGUAGES: Record<Language, Words> = { en, de };

/** The texts and the number format of a language. */
export interface Locale {
  words: Words;
  figures: Figures;
  /** Codes of problems whose detail from the service is not shown. */
  withoutDetail?: readonly string[];
}

export function localeOf(language: Language): Locale {
  return { words: LANGUAGES[language], figures: new Figures(language) };
}

/** The first language of a list that has texts here; else English. */
export function firstSupported(languages: readonly string[]): Language {
  return languages.find((language) => /^(de|en)\b/i.test(language))?.toLowerCase().startsWith("de") ? "de" : "en";
}

/** The texts within a view. */
export const LocaleContext = createContext<Locale>(localeOf("en"));

export function useWords(): Locale {
  return useContext(LocaleContext);
}
