import { createContext } from "preact";
import { useContext } from "preact/hooks";
import { dePage } from "./de-page";
import type { Words } from "./en";
import { enPage } from "./en-page";
import { type Language, type Speech, speech } from "./words";

/** All texts of the page: the shared texts and the page's own. */
export type PageWords = Words & typeof enPage;
const MORE: Record<Language, typeof enPage> = { en: enPage, de: dePage };

export interface PageSpeech extends Speech {
  words: PageWords;
}

export function pageSpeech(language: Language): PageSpeech {
  const { words, figures } = speech(language);
  return { words: { ...words, ...MORE[language] }, figures };
}

/** The texts of the page within a view. */
export const PageSpoken = createContext<PageSpeech>(pageSpeech("en"));

export function usePageWords(): PageSpeech {
  return useContext(PageSpoken);
}
