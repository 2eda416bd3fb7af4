// Results to choose from, and the question for the unit.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";
import { drop, open, shown } from "./support/browser.mjs";
import { browser, service } from "./support/service-and-browser.mjs";
import { hollowBox, inchPlate } from "./support/models.mjs";

test("a customer compares two results and downloads the chosen one", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["hollow.stl", hollowBox()]]);
  await shown(page);
  const choices = page.locator(".choice");
  await choices.first().waitFor();
  assert.equal(await choices.count(), 2);
  assert.match(await choices.nth(0).innerText(), /Proposed result[\s\S]*22 cm³[\s\S]*2 parts/);
  assert.match(await choices.nth(1).innerText(), /Sealed cavities filled[\s\S]*24 cm³[\s\S]*1 part/);
  const faces = async () => {
    const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: /^Download STL/ }).click()]);
    return (await readFile(await download.path())).readUInt32LE(80);
  };
  assert.equal(await faces(), 24);
  assert.doesNotMatch(await page.locator(".layers").innerText(), /faces removed/);
  await choices.nth(1).getByRole("radio").check();
  await page.locator(".layers", { hasText: "faces removed" }).waitFor();
  await shown(page);
  assert.match(await page.locator(".printing").innerText(), /24 cm³/);
  assert.equal(await faces(), 12);
  await choices.nth(0).getByRole("radio").check();
  await page.locator(".printing", { hasText: "22 cm³" }).waitFor();
  assert.equal(await faces(), 24);
  assert.deepEqual(faults, []);
  await close();
});

test("the page asks for the unit with the size under each candidate", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["plate.stl", inchPlate()]]);
  await shown(page);
  const question = page.locator(".unit-question");
  await question.waitFor();
  assert.match(await question.innerText(), /Inches · 76\.2 × 50\.8 × 3\.17 mm[\s\S]*Millimetres · 3 × 2 × 0\.125 mm/);
  await question.getByRole("button", { name: /^Inches/ }).click();
  await page.locator(".unit-question").waitFor({ state: "detached", timeout: 60_000 });
  await shown(page);
  assert.deepEqual(faults, []);
  await close();
});
