import assert from "node:assert/strict";
import { test } from "node:test";
import { de } from "../src/words/de";
import { dePage } from "../src/words/de-page";
import { en } from "../src/words/en";
import { enPage } from "../src/words/en-page";
import { TEXTS } from "../src/widget/texts";
import { texts } from "./texts";

test("every language has every text, and no text is empty", () => {
  const [english, german] = [texts([{ ...en, ...enPage }, TEXTS.en]), texts([{ ...de, ...dePage }, TEXTS.de])];
  assert.deepEqual(german.map(([name]) => name), english.map(([name]) => name));
  for (const [name, text] of [...english, ...german]) {
    assert.ok(text.length > 0 || name.endsWith(".0"), `${name} is empty`);
    assert.ok(!/undefined|NaN/.test(text), `${name}: ${text}`);
  }
});

test("no German text is left in English", () => {
  const english = new Map(texts([en, enPage, TEXTS.en]));
  const same = texts([de, dePage, TEXTS.de]).filter(([name, text]) => text.length > 14 && english.get(name) === text);
  assert.deepEqual(same, []);
});

test("the text of a tier does not repeat the name of the repair stage", () => {
  for (const { stages, tiers } of [en, de]) {
    for (const tier of tiers) assert.ok(tier === "" || !tier.toLowerCase().includes(stages.repair.toLowerCase()), tier);
  }
});
