import assert from "node:assert/strict";
import { test } from "node:test";
import { TEXTS } from "../src/widget/texts";
import { de } from "../src/words/de";
import { dePage } from "../src/words/de-page";
import { en } from "../src/words/en";
import { enPage } from "../src/words/en-page";
import { texts } from "./texts";

// The rules are those of tests/support/prose.rs: short sentences that name their subjects, without names of the code.

/** The most words of a sentence. */
const MAX_WORDS = 25;

/** Words that, as the subject of a sentence, do not say what they stand for. */
const BARE_SUBJECT = {
  en: /^(it|they)\b|^(this|that|these|those|such|what|who|which|so) (is|are|was|were|has|have|can|may|must|does|do|holds|means|cannot)\b/i,
  de: /^(Er|Es|Das|Dies|Diese|Dieser|Dieses|So|Was|Wer) (ist|sind|war|waren|hat|haben|kann|können|darf|dürfen|muss|müssen|wird|werden|wurde|wurden|bedeutet)\b/,
};

/** The sentences of a text. Code in backticks is one word, and the parts around a colon, a semicolon or a dot in the middle stand alone. */
function sentences(text: string): string[] {
  return text.replace(/`[^`]*`/g, "CODE").split(/\n|; | · |\. |: /).map((part) => part.trim()).filter((part) => part !== "");
}

function faults(text: string, language: "en" | "de"): string[] {
  return sentences(text).flatMap((sentence) => {
    const words = sentence.split(/\s+/).length;
    const names = sentence.match(/\b[a-z]+(_[a-z]+)+\b/g) ?? [];
    return [
      ...(words > MAX_WORDS ? [`${words} words: ${sentence}`] : []),
      ...(BARE_SUBJECT[language].test(sentence) ? [`bare subject: ${sentence}`] : []),
      ...names.map((name) => `name without backticks ${name}: ${sentence}`),
    ];
  });
}

for (const [language, all] of [["en", texts([en, enPage, TEXTS.en])], ["de", texts([de, dePage, TEXTS.de])]] as const) {
  test(`texts of the page and the widget are short and name their subjects: ${language}`, () => {
    assert.ok(all.length > 400, `only ${all.length} texts were found`);
    assert.deepEqual(all.flatMap(([name, text]) => faults(text, language).map((fault) => `${name}: ${fault}`)), []);
  });
}

test("long sentences, bare subjects and unmarked names are found", () => {
  for (const text of ["word ".repeat(MAX_WORDS + 1), "It is late.", "Wait. This is late.", "Raise max_tier."]) assert.notDeepEqual(faults(text, "en"), []);
  for (const text of ["Wort ".repeat(MAX_WORDS + 1), "Es ist spät.", "Das kann dauern."]) assert.notDeepEqual(faults(text, "de"), []);
  assert.deepEqual(faults("This model is late. Raise `max_tier`.", "en"), []);
  assert.deepEqual(faults("Das Modell ist offen.", "de"), []);
});
