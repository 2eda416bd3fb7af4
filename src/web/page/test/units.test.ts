import assert from "node:assert/strict";
import { test } from "node:test";
import { Figures, fit } from "../src/units";

const en = new Figures("en");
const de = new Figures("de");

test("formats lengths in the chosen unit and language", () => {
  assert.equal(en.length(25.4, "in"), "1 in");
  assert.equal(en.length(1234.5678, "mm"), "1,235 mm");
  assert.equal(de.length(0.00214, "mm", 2), "0,0021 mm");
  assert.equal(en.volume(61352.3, "mm"), "61.35 cm³");
  assert.equal(en.area(645.16, "in"), "1 in²");
});

test("formats numbers of any size briefly and correctly", () => {
  assert.equal(en.number(123456), "123,456");
  assert.equal(en.number(1e-12), "1E-12");
  assert.equal(en.number(3.2e15), "3.2E15");
  assert.equal(en.number(Number.NaN), "–");
  assert.equal(en.number(0), "0");
});

test("formats sizes and times in suitable units", () => {
  assert.deepEqual([0, 999, 1000, 573_084, 536_870_912].map((n) => en.bytes(n)), ["0 B", "999 B", "1 kB", "573 kB", "537 MB"]);
  assert.deepEqual([0.4, 12, 1500, 36_600, 600_000].map((n) => en.seconds(n)), ["0.4 ms", "12 ms", "1.5 s", "36.6 s", "10 min"]);
});

test("a model fits as it is, turned, or not at all", () => {
  assert.equal(fit([200, 100, 10], [220, 220, 250]), "as_is");
  assert.equal(fit([10, 10, 240], [250, 210, 220]), "turned");
  assert.equal(fit([251, 1, 1], [250, 210, 220]), "no");
});
