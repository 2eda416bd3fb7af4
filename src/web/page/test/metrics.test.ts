import assert from "node:assert/strict";
import { test } from "node:test";
import { readMetrics, valueOf } from "../src/report/metrics";

const TEXT = `# HELP meshmend_jobs Jobs
meshmend_jobs{status="queued"} 3
meshmend_jobs{status="running"} NaN
meshmend_class_jobs{class="gold",status="queued"} 1
meshmend_class_jobs{class="a\\"b",status="queued"} 2
meshmend_queue_wait_seconds 0.5
`;

test("finds metrics by name and labels", () => {
  const samples = readMetrics(TEXT);
  assert.equal(samples.length, 5);
  assert.equal(valueOf(samples, "meshmend_jobs", { status: "queued" }), 3);
  assert.equal(valueOf(samples, "meshmend_class_jobs", { status: "queued" }), 3);
  assert.equal(valueOf(samples, "meshmend_queue_wait_seconds"), 0.5);
});

test("an unknown metric has the value null", () => {
  const samples = readMetrics(TEXT);
  assert.equal(valueOf(samples, "meshmend_jobs", { status: "running" }), null);
  assert.equal(valueOf(samples, "meshmend_none"), null);
});
