import assert from "node:assert/strict";
import { test } from "node:test";
import { type Job, Problem } from "meshmend-client";
import { metricsOf } from "../src/widget/metrics";
import { type TokenSource, Tokens } from "../src/widget/tokens";

const print = { unit: "in", unit_source: "file", size: [1, 2, 3], size_mm: [25.4, 50.8, 76.2], area: 22, volume: 6, solids: 1, thinnest_wall: { thickness: 0.5 } };

function job(outcome: string, inspections: object): Job {
  return { status: "succeeded", outcome, artifacts: {}, report: { mode: "repair", ...inspections } } as unknown as Job;
}

test("measures the result in millimetres", () => {
  const after = { print, bounding_box: { min: [0, 0, 0], max: [1, 2, 3] } };
  const metrics = metricsOf(job("repaired", { before: { print: { ...print, volume: 1 } }, after }));
  assert.ok(metrics);
  assert.deepEqual([metrics.printable, metrics.unit, metrics.unitSource, metrics.solids], [true, "in", "file", 1]);
  assert.deepEqual([metrics.sizeMm, metrics.boxMm?.max], [[25.4, 50.8, 76.2], [25.4, 50.8, 3 * 25.4]]);
  assert.deepEqual([metrics.volumeMm3, metrics.areaMm2, metrics.thinnestWallMm], [6 * 25.4 ** 3, 22 * 25.4 ** 2, 12.7]);
  assert.equal(metricsOf(job("partially_repaired", { before: { print }, after: null }))?.printable, false);
  assert.equal(metricsOf(job("unrepairable", { before: { print: null }, after: null })), null);
});

test("an unavailable model has no metrics", () => {
  const refused = { ...job("", { before: { print }, after: { print } }), status: "failed", outcome: null, problem: { code: "not_printable" } } as unknown as Job;
  assert.equal(metricsOf(refused), null);
});

const never = new AbortController().signal;

/** Tokens of a page whose function gives one after the other, and which of them the service takes. */
function tokens(given: string[], good: string, source: Partial<TokenSource> = {}) {
  const getToken = async (): Promise<string> => given.shift() ?? "";
  const it = new Tokens(() => ({ getToken, token: null, tokenUrl: null, ...source }));
  const asked: (string | null)[] = [];
  const ask = () =>
    it.request("https://service", never, async (server) => {
      asked.push(server.key());
      if (server.key() !== good) throw new Problem(401, "unauthorized", "", "");
      return server.base;
    });
  return { ask, asked };
}

test("reuses a token until it expires, then retries once with a new one", async () => {
  const { ask, asked } = tokens(["old", "new", "newer"], "new");
  assert.equal((await ask()).answer, "https://service");
  assert.equal((await ask()).server.key(), "new");
  assert.deepEqual(asked, ["old", "new", "new"]);
  const bad = tokens(["a", "b", "c"], "none");
  await assert.rejects(bad.ask(), { code: "unauthorized" });
  assert.deepEqual(bad.asked, ["a", "b"]);
});

test("a token from the attribute is not replaced after it expires", async () => {
  const { ask, asked } = tokens([], "none", { getToken: null, token: "given" });
  await assert.rejects(ask(), { code: "unauthorized" });
  assert.deepEqual(asked, ["given"]);
  await assert.rejects(tokens([], "x", { getToken: null }).ask(), { code: "token_missing" });
  await assert.rejects(tokens([""], "x").ask(), { code: "token_refused" });
});
