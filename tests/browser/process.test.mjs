// The rules of a printing process: chosen for a model, shown as a table, and visited in the viewer.
import assert from "node:assert/strict";
import { test } from "node:test";
import { drop, open, shown } from "./support/browser.mjs";
import { browser, service } from "./support/service-and-browser.mjs";
import { plate, soundBox } from "./support/models.mjs";
import { repaired } from "./support/service.mjs";

test("a model is checked against the chosen process and shows its broken rules", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await page.getByLabel("Check for a printing process").selectOption("fdm-0.4");
  await drop(page, [["plate.stl", plate()]]);
  await shown(page);
  const table = page.locator("table.rules");
  await table.waitFor();
  const row = table.locator("tr", { hasText: "Volume of each solid" });
  assert.match(await row.innerText(), /broken[\s\S]*27 mm³[\s\S]*7\.2 mm³[\s\S]*Remove the small solids/);
  assert.match(await table.locator("tr", { hasText: "Build volume" }).innerText(), /met[\s\S]*200 mm[\s\S]*6 mm/);
  assert.match(await table.locator("tbody tr").first().getAttribute("class"), /fail/, "broken rules come first");
  await row.getByRole("button", { name: "Show in the viewer: Volume of each solid" }).click();
  await row.getByText("1 of 1").waitFor();
  await page.getByRole("status").getByText("The model breaks").waitFor();
  assert.deepEqual(faults, []);
  await close();
});

/** A block of 20 mm with a square pit of 16 x 16 x 18 mm that opens upward. */
const CUP = `v 0 0 0\nv 20 0 0\nv 20 20 0\nv 0 20 0\nv 0 0 20\nv 20 0 20\nv 20 20 20\nv 0 20 20
v 2 2 2\nv 18 2 2\nv 18 18 2\nv 2 18 2\nv 2 2 20\nv 18 2 20\nv 18 18 20\nv 2 18 20
f 4 3 2 1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8
f 5 6 14 13\nf 6 7 15 14\nf 7 8 16 15\nf 8 5 13 16
f 13 14 10 9\nf 14 15 11 10\nf 15 16 12 11\nf 16 13 9 12\nf 9 10 11 12\n`;

test("a hollow that holds resin is named below the rules and shown in the viewer", { timeout: 120_000 }, async () => {
  const job = await repaired(service.url, "cup.obj", Buffer.from(CUP), { process: "sla-resin" });
  const { page, faults, close } = await open(browser, service.url, { path: `/#/result/${job.id}` });
  await shown(page);
  const hollow = page.locator(".print-ready p", { hasText: "Hollows that hold resin: 1." });
  assert.match(await hollow.innerText(), /The largest holds 4,608 mm³ while it prints in this orientation\./);
  await hollow.getByRole("button", { name: "Show in the viewer: Hollows that hold resin" }).click();
  await hollow.getByText("1 of 1").waitFor();
  assert.deepEqual(faults, []);
  await close();
});

test("another process is a new job with the same file, and no process removes the table", { timeout: 120_000 }, async () => {
  const job = await repaired(service.url, "box.stl", soundBox(), { process: "fdm-0.4" });
  const { page, faults, close } = await open(browser, service.url, { path: `/#/result/${job.id}` });
  await shown(page);
  await page.getByLabel("Check for another process").selectOption("sls-pa12");
  await page.locator(".print-ready").getByText("SLS", { exact: false }).first().waitFor({ timeout: 60_000 });
  await page.getByLabel("Check for another process").selectOption("");
  await page.getByLabel("Check for a printing process").waitFor({ timeout: 60_000 });
  assert.equal(await page.locator("table.rules").count(), 0);
  assert.deepEqual(faults, []);
  await close();
});

test("the rules are shown in German, and a tenant's own process can be chosen", { timeout: 120_000 }, async () => {
  const body = JSON.stringify({ based_on: "sls-pa12", title: "Werkstatt", build_volume_mm: [5, 5, 5] });
  const put = await fetch(`${service.url}/v1/profiles/werkstatt`, { method: "PUT", headers: { "content-type": "application/json" }, body });
  assert.ok(put.ok, await put.text());
  const { page, faults, close } = await open(browser, service.url, { locale: "de-DE" });
  await page.getByLabel("Für ein Druckverfahren prüfen").selectOption("werkstatt");
  await drop(page, [["plate.stl", plate()]]);
  await shown(page);
  const row = page.locator("table.rules tr", { hasText: "Bauraum" });
  assert.match(await row.innerText(), /verletzt[\s\S]*5 mm[\s\S]*6 mm/);
  assert.deepEqual(faults, []);
  await close();
});
