import assert from "node:assert/strict";
import { test } from "node:test";
import type { Report } from "meshmend-client";
import { repairSummary, remainingDefects } from "../src/report/summary";
import { Figures } from "../src/units";
import { de } from "../src/words/de";
import { en } from "../src/words/en";

const figures = new Figures("en");

function report(change: object): Report {
  const before = { defects: [{ kind: "hole", count: 11 }, { kind: "disjoint", count: 1 }], print: { unit: "mm", size: [80, 80, 20] } };
  return {
    mode: "repair",
    outcome: "repaired",
    before,
    after: { defects: [] },
    changes: { moved: { distance: { max: 0.002 } }, surface: { kept: { area: 98 }, moved: { area: 0 }, added: { area: 2 }, removed: { area: 9 } } },
    part_accounting: { parts: 2, united: 2, duplicate: 0, no_volume: 0, debris: 0 },
    steps: [],
    candidates: [],
    ...change,
  } as unknown as Report;
}

test("describes a repair in plain words", () => {
  assert.deepEqual(repairSummary(report({}), en, figures, "mm"), [
    "11 holes closed",
    "2 parts united",
    "2% of the surface is new",
    "nothing moved more than 0.002 mm",
  ]);
  assert.equal(repairSummary(report({}), de, new Figures("de"), "mm")[0], "11 Löcher geschlossen");
});

test("lists only removed defects as repaired, and lists remaining defects", () => {
  const partly = report({ outcome: "partially_repaired", after: { defects: [{ kind: "hole", count: 1 }, { kind: "sheet", count: 2 }] } });
  assert.equal(repairSummary(partly, en, figures, "mm")[0], "10 holes closed");
  assert.equal(remainingDefects(partly, en, figures), "1 hole, 2 sheets without thickness");
});

test("moves within the rounding error count as none", () => {
  const changes = { moved: { distance: { max: 4e-7 } } };
  assert.ok(repairSummary(report({ changes }), en, figures, "mm").includes("nothing was moved"));
});

test("lengths appear in the chosen unit, whatever the file's unit", () => {
  const inches = report({ before: { defects: [], print: { unit: "in", size: [3, 3, 1] } } });
  assert.ok(repairSummary(inches, en, figures, "mm").includes("nothing moved more than 0.051 mm"));
});

test("an already printable model is reported as unchanged", () => {
  assert.deepEqual(repairSummary(report({ outcome: "already_printable" }), en, figures, "mm"), [en.untouched]);
});

test("what options asked for is listed, and a vented cavity is no united part", () => {
  const thickening = { added_volume_mm3: 360.6 };
  const step = (kind: string, count: number, more = {}): object => ({ status: "done", strategy: 0, changed: [{ kind, count }], ...more });
  const candidates = [{ chosen: true, strategy: 0 }];
  const lines = (steps: object[]): string[] => repairSummary(report({ before: { defects: [] }, steps, candidates }), en, figures, "mm");
  assert.deepEqual(lines([step("walls_thickened", 2, { thickening })]).slice(0, 2), ["2 thin walls thickened with 0.3606 cm³ of material", "2 parts united"]);
  const vented = lines([step("voids_vented", 1)]);
  assert.equal(vented[0], "1 sealed cavity opened with vents");
  assert.ok(!vented.some((line) => line.includes("united")));
  assert.ok(!lines([{ ...step("voids_vented", 1), status: "reverted" }]).some((line) => line.includes("cavity")));
});

test("the boundary of a thickened sheet does not count as a closed hole", () => {
  const before = { defects: [{ kind: "hole", count: 62 }], print: { unit: "mm", size: [80, 80, 20] } };
  const step = (kind: string, count: number): object => ({ status: "done", strategy: 1, changed: [{ kind, count }] });
  const made = { before, steps: [step("holes_closed", 3), step("sheets_thickened", 36), { ...step("holes_closed", 50), strategy: 0 }], candidates: [{ chosen: true, strategy: 1 }] };
  assert.equal(repairSummary(report(made), en, figures, "mm")[0], "3 holes closed");
  const objects = [made, made];
  assert.equal(repairSummary(report({ before, objects }), en, figures, "mm")[0], "6 holes closed");
  const none = { ...made, steps: [step("sheets_thickened", 36)] };
  assert.ok(!repairSummary(report(none), en, figures, "mm").some((line) => line.includes("hole")));
});
