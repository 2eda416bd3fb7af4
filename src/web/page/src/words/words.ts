import { createContext } from "preact";
import { useContext } from "preact/hooks";
import { Figures } from "../units";
import { de } from "./de";
import { type Words, en } from "./en";

export type Language = "en" | "de";
export const LANGUAGES: Record<Language, Words> = { en, de };

/** The texts and the number format of a language. */
export interface Speech {
  words: Words;
  figures: Figures;
}

export function speech(language: Language): Speech {
  return { words: LANGUAGES[language], figures: new Figures(language) };
}

/** The first language of a list that has texts here; else English. */
export function firstSpoken(languages: readonly string[]): Language {
  return languages.find((it) => /^(de|en)\b/i.test(it))?.toLowerCase().startsWith("de") ? "de" : "en";
}

/** The texts within a view. */
export const Spoken = createContext<Speech>(speech("en"));

export function useWords(): Speech {
  return useContext(Spoken);
}
