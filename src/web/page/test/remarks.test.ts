import assert from "node:assert/strict";
import { test } from "node:test";
import type { Report } from "meshmend-client";
import document from "../../../../openapi/openapi.json";
import { assumptionsOf, notesOf, warningsOf, withOption } from "../src/report/remarks";
import { Figures } from "../src/units";
import { de } from "../src/words/de";
import { en } from "../src/words/en";

const figures = new Figures("en");

function report(change: object): Report {
  const print = { unit: "in", thinnest_wall: { thickness: 0.02 } };
  return { mode: "repair", before: { print }, after: null, red_flags: [], assumptions: [], warnings: [], options_not_applied: [], ...change } as unknown as Report;
}

test("every kind of flag and assumption of the service has a text in both languages", () => {
  const { schemas } = document.components;
  for (const words of [en, de]) {
    assert.deepEqual(schemas.RedFlagCode.enum.filter((code) => !words.flagTexts[code]), []);
    assert.deepEqual(schemas.AssumptionKind.enum.filter((kind) => !words.assumptionTexts[kind]), []);
  }
});

test("numbers of flags are percentages, counts or lengths", () => {
  const red_flags = [
    { code: "surface_lost", value: 12.34, threshold: 1, detail: "a" },
    { code: "parts_merged", value: 3, threshold: 1, detail: "b" },
    { code: "deviation", value: 1, threshold: 0.5, detail: "c" },
    { code: "a_later_one", value: 1, threshold: 0, detail: "Something else is wrong." },
  ];
  const told = warningsOf(report({ red_flags }), false, en, figures, "mm");
  assert.deepEqual(told.map(({ text }) => text), [
    "12.3% of the visible surface is missing in the result.",
    "3 parts became one part.",
    "The surface moved by up to 25.4 mm. Your limit is 12.7 mm.",
    "Something else is wrong.",
  ]);
  assert.deepEqual(told.map(({ isEnglish }) => isEnglish), [false, false, false, true]);
});

test("warns of a thin wall only if the model is printable", () => {
  assert.deepEqual(warningsOf(report({}), true, en, figures, "mm").map(({ text }) => text), ["The thinnest wall is 0.51 mm. Most printers need at least 0.8 mm."]);
  assert.deepEqual(warningsOf(report({}), false, en, figures, "mm"), []);
});

test("an assumption shows its thickness in the chosen unit, and its option", () => {
  const assumptions = [
    { kind: "sheets_thickened", count: 1, amount: 0.01, detail: "x", option: "open_sheets=leave" },
    { kind: "unit", count: 1, detail: "y", option: "unit=mm" },
  ];
  const told = assumptionsOf(report({ assumptions }), en, figures, "mm");
  assert.deepEqual(told.map(({ text, option }) => [text, option]), [
    ["1 open surface was given a thickness of 0.25 mm.", "open_sheets=leave"],
    ["The file states no unit. Its lengths were read as in.", "unit=mm"],
  ]);
});

test("notes are sentences, and list options that were not applied", () => {
  const options_not_applied = [{ option: "thickness", value: "2", cause: "nothing_to_do", reason: "there is no open surface" }];
  const told = notesOf(report({ warnings: ["bytes were left out"], options_not_applied }), en);
  assert.deepEqual(told.map(({ text }) => text), ["Bytes were left out.", "The option thickness=2 was not applied. There is no open surface."]);
});

test("setting one option keeps the others, and operators are appended to lists", () => {
  assert.deepEqual(withOption({ max_tier: 2 }, "winding_rule=nonzero"), { max_tier: 2, winding_rule: "nonzero" });
  assert.deepEqual(withOption({}, "max_hole_size=0.25"), { max_hole_size: 0.25 });
  assert.deepEqual(withOption({ without: ["sew"] }, "without=join_parts"), { without: ["sew", "join_parts"] });
});
