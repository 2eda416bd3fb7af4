import { createContext } from "preact";
import { useContext } from "preact/hooks";
import { dePage } from "./de-page";
import type { Words } from "./en";
import { enPage } from "./en-page";
import { type Language, type Locale, localeOf } from "./locale";

/** All texts of the page: the shared texts and the page's own. */
export type PageWords = Words & typeof enPage;
const MORE: Record<Language, typeof enPage> = { en: enPage, de: dePage };

export interface PageLocale extends Locale {
  words: PageWords;
}

export function pageLocaleOf(language: Language): PageLocale {
  const { words, figures } = localeOf(language);
  return { words: { ...words, ...MORE[language] }, figures };
}

/** The texts of the page within a view. */
export const PageLocaleContext = createContext<PageLocale>(pageLocaleOf("en"));

export function usePageWords(): PageLocale {
  return useContext(PageLocaleContext);
}
