// Files that go straight between the browser and an S3-compatible bucket on another origin.
import assert from "node:assert/strict";
import { test } from "node:test";
import { LOOKS, drop, launch, open, pixels, shown } from "./support/browser.mjs";
import { bucket } from "./support/bucket.mjs";
import { brokenRing } from "./support/models.mjs";
import { serve } from "./support/service.mjs";
import { openShop } from "./support/shop.mjs";

/** Opens the page of a service or shop that uses a bucket; `use` also gets the methods of the requests to the bucket. */
async function onBucket(how, start, use) {
  const store = await bucket(how);
  const started = await start(store);
  const browser = await launch();
  try {
    const opened = await open(browser, started.url);
    const methods = [];
    opened.page.on("request", (request) => request.url().startsWith(store.url) && methods.push(request.method()));
    await use({ ...opened, methods });
    await opened.close();
  } finally {
    await browser.close();
    await started.stop();
    await store.stop();
  }
}

test("the page sends a model straight to the bucket and fetches the result from there", { timeout: 120_000 }, () =>
  onBucket({}, (store) => serve(...store.args), async ({ page, faults, asked, methods }) => {
    await drop(page, [["ring.stl", brokenRing()]]);
    await shown(page);
    await page.getByRole("heading", { name: "Repaired and printable" }).waitFor();
    const { grey } = await pixels(page, LOOKS);
    assert.ok(grey > 10_000, "the models are on the canvas");
    assert.equal(methods.filter((method) => method === "PUT").length, 1, `${methods}`);
    assert.ok(methods.filter((method) => method === "GET").length >= 2, `both models come from the bucket: ${methods}`);
    assert.ok(!asked.some((url) => /\/v1\/uploads\/.*\/content/.test(url)), "nothing is sent through the service");
    assert.deepEqual(faults, []);
  }));

test("the widget on a shop's page sends to and fetches from the bucket too", { timeout: 120_000 }, () =>
  onBucket({}, openShop, async ({ page, faults, asked, methods }) => {
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
  }));

test("if the bucket refuses the page, the page says what the operator must do", { timeout: 120_000 }, () =>
  onBucket({ cors: null }, (store) => serve(...store.args), async ({ page }) => {
    await drop(page, [["ring.stl", brokenRing()]]);
    await page.getByText("in the bucket's CORS rules").waitFor({ timeout: 60_000 });
  }));
