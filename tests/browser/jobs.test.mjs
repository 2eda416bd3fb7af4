// The jobs view for operators.
import assert from "node:assert/strict";
import { test } from "node:test";
import { open, shown } from "./support/browser.mjs";
import { browser, service } from "./support/service-and-browser.mjs";
import { brokenRing, soundBox } from "./support/models.mjs";
import { repaired, serve } from "./support/service.mjs";

test("jobs are listed by status and page, with the service's health beside them", { timeout: 120_000 }, async () => {
  // More than one page of jobs, all but the first with a reused result.
  for (let i = 0; i < 27; i += 1) await repaired(service.url, `box-${i}.stl`, soundBox());
  await repaired(service.url, "cut.stl", Buffer.from("solid cut\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"));
  const { page, faults, close } = await open(browser, service.url, { path: "/#/jobs" });
  const rows = page.locator("tbody tr");
  await rows.first().waitFor();
  assert.equal(await rows.count(), 25);
  assert.match(await rows.first().textContent(), /cut\.stl.*failed/);
  await page.getByRole("button", { name: "Older jobs" }).click();
  await rows.nth(27).waitFor();
  assert.equal(await rows.count(), 28);
  await page.getByLabel("Status").selectOption("failed");
  await page.waitForFunction(() => document.querySelectorAll("tbody tr").length === 1);
  await page.getByLabel("Status").selectOption("canceled");
  await page.getByText("No jobs here yet").waitFor();

  const health = page.getByRole("complementary", { name: "Health" });
  await health.getByText("The service is ready").waitFor();
  await health.getByText("3. Blender: not available").waitFor();
  await health.getByText("disk: ok").waitFor();
  assert.match(await health.textContent(), /0waiting.*0running|waiting0.*running0/s);
  assert.deepEqual(faults, []);
  await close();
});

test("a job has its steps, its log and its files, and is run again with other options", { timeout: 120_000 }, async () => {
  const job = await repaired(service.url, "ring.stl", brokenRing());
  const { page, faults, close } = await open(browser, service.url, { path: `/#/jobs/${job.id}` });
  await page.getByRole("heading", { name: "ring.stl" }).waitFor();
  const steps = page.locator("table.steps tbody tr");
  assert.equal(await steps.count(), job.report.steps.length);
  assert.match(await steps.filter({ hasText: "fill holes" }).first().textContent(), /2 holes closed/);
  await page.getByText("Log of the job and of Blender").click();
  const log = await (await fetch(`${service.url}${job.artifacts["log.txt"].href}`)).text();
  await page.waitForFunction(() => !document.querySelector(".log pre").textContent.includes("Loading"));
  assert.equal(await page.locator(".log pre").textContent(), log);
  await page.getByLabel("Format").selectOption("off");
  await page.getByRole("button", { name: "Run again" }).click();
  await page.getByRole("button", { name: "Download OFF" }).waitFor({ timeout: 60_000 });
  await shown(page);
  assert.deepEqual(faults, []);
  await close();
});

test("a running job is followed and canceled, and a finished one is deleted after a confirmation", { timeout: 120_000 }, async () => {
  // No worker runs here, so the job stays queued.
  const waiting = await serve("--no-workers");
  try {
    const form = new FormData();
    form.set("file", new Blob([brokenRing()]), "ring.stl");
    const job = await (await fetch(`${waiting.url}/v1/jobs`, { method: "POST", body: form })).json();
    const { page, faults, close } = await open(browser, waiting.url, { path: `/#/jobs/${job.id}` });
    await page.getByText("next in the queue").waitFor();
    await page.getByRole("button", { name: "Cancel", exact: true }).click();
    await page.locator(".chip", { hasText: "canceled" }).waitFor();
    await page.getByRole("button", { name: "Delete", exact: true }).click();
    await page.getByRole("button", { name: "Keep it" }).click();
    assert.equal((await fetch(`${waiting.url}/v1/jobs/${job.id}`)).status, 200);
    await page.getByRole("button", { name: "Delete", exact: true }).click();
    await page.getByRole("button", { name: "Delete it" }).click();
    await page.getByText("The job and its files have been deleted.").waitFor();
    assert.equal((await fetch(`${waiting.url}/v1/jobs/${job.id}`)).status, 410);
    assert.deepEqual(faults, []);
    await close();
  } finally {
    await waiting.stop();
  }
});

test("a missing job is reported", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url, { path: "/#/jobs/job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a" });
  await page.getByText("This job does not exist, or it belongs to another account.").waitFor();
  await page.getByRole("link", { name: "All jobs" }).click();
  await page.getByRole("heading", { name: "Jobs" }).waitFor();
  await close();
});
