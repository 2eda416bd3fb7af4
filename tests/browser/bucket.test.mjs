// Files that go straight between the browser and an S3-compatible bucket on another origin.
import assert from "node:assert/strict";
import { test } from "node:test";
import { LOOKS, drop, launch, open, pixels, shown } from "./support/browser.mjs";
import { bucket } from "./support/bucket.mjs";
import { brokenRing } from "./support/models.mjs";
import { serve } from "./support/service.mjs";
import { openShop } from "./support/shop.mjs";

test("the page sends a model straight to the bucket and fetches the result from there", { timeout: 120_000 }, async () => {
  const store = await bucket();
  const service = await serve(...store.args);
  const browser = await launch();
  try {
    const { page, faults, asked, close } = await open(browser, service.url);
    const methods = [];
    page.on("request", (request) => request.url().startsWith(store.url) && methods.push(request.method()));
    await drop(page, [["ring.stl", brokenRing()]]);
    await shown(page);
    await page.getByRole("heading", { name: "Repaired and printable" }).waitFor();
    const { grey } = await pixels(page, LOOKS);
    assert.ok(grey > 10_000, "the models are on the canvas");
    assert.equal(methods.filter((method) => method === "PUT").length, 1, `${methods}`);
    assert.ok(methods.filter((method) => method === "GET").length >= 2, `both models come from the bucket: ${methods}`);
    assert.ok(!asked.some((url) => /\/v1\/uploads\/.*\/content/.test(url)), "nothing is sent through the service");
    assert.deepEqual(faults, []);
    await close();
  } finally {
    await browser.close();
    await service.stop();
    await store.stop();
  }
});

test("the widget on a shop's page does the same", { timeout: 120_000 }, async () => {
  const store = await bucket();
  const shop = await openShop(store);
  const browser = await launch();
  try {
    const { page, faults, asked, close } = await open(browser, shop.url);
    const methods = [];
    page.on("request", (request) => request.url().startsWith(store.url) && methods.push(request.method()));
    await page.getByText("Drop your 3D model here").waitFor();
    await drop(page, [["ring.stl", brokenRing()]], "meshmend-upload .box");
    await shown(page);
    await page.getByRole("heading", { name: "Repaired and printable" }).waitFor();
    assert.equal(methods.filter((method) => method === "PUT").length, 1, `${methods}`);
    assert.ok(methods.includes("GET"), `the model comes from the bucket: ${methods}`);
    assert.ok(!asked.some((url) => /\/v1\/uploads\/.*\/content/.test(url)), "nothing is sent through the service");
    await page.getByRole("button", { name: "Order" }).click();
    await page.getByText("Your order is in production").waitFor();
    assert.deepEqual(faults, []);
    await close();
  } finally {
    await browser.close();
    await shop.stop();
    await store.stop();
  }
});

test("where the bucket refuses the page, it says what the operator has to do", { timeout: 120_000 }, async () => {
  const store = await bucket({ cors: null });
  const service = await serve(...store.args);
  const browser = await launch();
  try {
    const { page, close } = await open(browser, service.url);
    await drop(page, [["ring.stl", brokenRing()]]);
    await page.getByText("in the bucket's CORS rules").waitFor({ timeout: 60_000 });
    await close();
  } finally {
    await browser.close();
    await service.stop();
    await store.stop();
  }
});
