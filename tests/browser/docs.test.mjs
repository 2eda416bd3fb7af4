// Accessibility of the documentation: screen readers, keyboards, dark mode, phones, and no scripts.
import assert from "node:assert/strict";
import { test } from "node:test";
import { open, violations } from "./support/browser.mjs";
import { browser, service } from "./support/service-and-browser.mjs";

/** The URLs of all pages in the index. */
async function pages() {
  const { page, close } = await open(browser, service.url, { path: "/docs/" });
  const paths = await page.locator("nav.pages a").evaluateAll((links) => links.map((link) => new URL(link.href).pathname));
  await close();
  assert.ok(paths.length > 8, String(paths));
  return paths;
}

for (const colorScheme of ["light", "dark"]) {
  test(`axe-core finds nothing wrong in the ${colorScheme}`, { timeout: 180_000 }, async () => {
    for (const path of await pages()) {
      const { page, faults, close } = await open(browser, service.url, { path, colorScheme });
      assert.deepEqual(await violations(page), [], path);
      assert.deepEqual(faults, [], path);
      await close();
    }
  });
}

test("no page is wider than a phone, and its tables and commands scroll with the keyboard", { timeout: 120_000 }, async () => {
  for (const path of await pages()) {
    const { page, close } = await open(browser, service.url, { path, viewport: { width: 360, height: 740 } });
    const wide = await page.evaluate(() => document.documentElement.scrollWidth);
    assert.ok(wide <= 360, `${path}: ${wide}`);
    const stuck = await page
      .locator("article :is(pre, .wide)")
      .evaluateAll((all) => all.filter((element) => element.scrollWidth > element.clientWidth && element.tabIndex !== 0).length);
    assert.equal(stuck, 0, path);
    const marks = await page.locator("nav li").evaluateAll((all) => [...new Set(all.map((element) => getComputedStyle(element).listStyleType))]);
    assert.deepEqual(marks, ["none"], `${path}: lists of links have no marks`);
    await close();
  }
});

test("the keyboard alone reaches the text, a section and another page", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url, { path: "/docs/options" });
  await page.keyboard.press("Tab");
  assert.equal(await page.evaluate(() => document.activeElement.textContent), "Skip to the content");
  await page.keyboard.press("Enter");
  assert.equal(await page.evaluate(() => document.activeElement.id), "main");
  await page.getByRole("navigation", { name: "On this page" }).getByRole("link", { name: "Operators" }).press("Enter");
  assert.equal(new URL(page.url()).hash, "#operators");
  await page.getByRole("navigation", { name: "Documentation" }).getByRole("link", { name: "Problems" }).press("Enter");
  await page.getByRole("heading", { level: 1, name: "Problems" }).waitFor();
  assert.equal(await page.locator("[aria-current=page]").textContent(), "Problems");
  await close();
});

test("pictures are shown at their size, and nothing is loaded from other hosts", { timeout: 60_000 }, async () => {
  const { page, asked, close } = await open(browser, service.url, { path: "/docs/how-repair-works" });
  for (const picture of await page.locator("article img").all()) {
    await picture.scrollIntoViewIfNeeded();
    await picture.evaluate((element) => element.decode());
    const [shape, declared] = await picture.evaluate((image) => [image.naturalWidth / image.naturalHeight, image.width / image.height]);
    assert.ok(Math.abs(shape - declared) < 0.01, `${shape} ${declared}`);
  }
  assert.deepEqual(asked.filter((url) => !url.startsWith(service.url)), []);
  await close();
});

test("the repair page links to the documentation, and the documentation links back", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url);
  await page.getByRole("link", { name: "Docs" }).click();
  await page.getByRole("heading", { level: 1, name: "Documentation" }).waitFor();
  await page.getByRole("link", { name: "API", exact: true }).first().waitFor();
  await page.getByRole("link", { name: "Repair", exact: true }).click();
  await page.getByRole("heading", { name: "Drop a 3D model" }).waitFor();
  await close();
});

test("the widget's page has no snippet that is not JavaScript", { timeout: 60_000 }, async () => {
  const text = await (await fetch(`${service.url}/docs/widget.md`)).text();
  const snippets = [...text.matchAll(/^```js\n(.*?)^```/gms)].map(([, code]) => code);
  assert.ok(snippets.length >= 3, `${snippets.length}`);
  const AsyncFunction = (async () => {}).constructor;
  for (const code of snippets) assert.doesNotThrow(() => new AsyncFunction(code), code);
});
