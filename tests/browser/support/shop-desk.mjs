// The demo shop and a browser, for all the tests of a file, and what they ask of the widget.
import { launchBeside, open } from "./browser.mjs";
import { openShop } from "./shop.mjs";

export const shop = await openShop();
export const browser = await launchBeside(shop);

/** Where files are let go. */
export const BOX = "meshmend-upload .box";
/** A file that says it is a model and breaks off. */
export const CUT = Buffer.from("solid cut\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n");

export const widget = (page) => page.locator("meshmend-upload");

/** Opens the shop's page, which keeps the events that it is told. */
export async function visit({ url = shop.url, ...options } = {}) {
  const it = await open(browser, url, options);
  await it.page.getByText("Drop your 3D model here").or(it.page.getByText("3D-Modell hier ablegen")).waitFor();
  await it.page.evaluate(() => {
    globalThis.told = [];
    for (const name of ["uploaded", "progress", "repaired", "failed"]) {
      document.addEventListener(name, ({ detail }) => told.push([name, detail]));
    }
  });
  return it;
}

/** The details of all events of a name, when there is one. */
export async function told(page, name) {
  await page.waitForFunction((name) => told.some(([it]) => it === name), name, { timeout: 60_000 });
  return page.evaluate((name) => told.filter(([it]) => it === name).map(([, detail]) => detail), name);
}

/** A job with its report, as the shop's backend sees it. */
export async function jobOf(id) {
  return (await shop.ask(`/v1/jobs/${id}?include=report`)).json();
}
