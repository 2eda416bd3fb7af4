// The demo shop and a browser for all tests of a file, and helpers for the widget.
import { launchBeside, open } from "./browser.mjs";
import { openShop } from "./shop.mjs";

export const shop = await openShop();
export const browser = await launchBeside(shop);

/** The drop zone. */
export const BOX = "meshmend-upload .box";
/** A truncated model file. */
export const CUT = Buffer.from("solid cut\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n");

export const widget = (page) => page.locator("meshmend-upload");

/** Opens the shop's page, which records the widget's events. */
export async function visit({ url = shop.url, ...options } = {}) {
  const opened = await open(browser, url, options);
  await opened.page.getByText("Drop your 3D model here").or(opened.page.getByText("3D-Modell hier ablegen")).waitFor();
  await opened.page.evaluate(() => {
    globalThis.events = [];
    for (const name of ["uploaded", "progress", "repaired", "failed"]) {
      document.addEventListener(name, ({ detail }) => events.push([name, detail]));
    }
  });
  return opened;
}

/** Sets the widget's options, as a shop's page does. */
export function setOptions(page, options) {
  return widget(page).evaluate((element, text) => element.setAttribute("options", text), JSON.stringify(options));
}

/** The details of all events with a name; waits for the first. */
export async function eventDetails(page, name) {
  await page.waitForFunction((name) => events.some(([other]) => other === name), name, { timeout: 60_000 });
  return page.evaluate((name) => events.filter(([other]) => other === name).map(([, detail]) => detail), name);
}

/** A job with its report, as the shop's backend sees it. */
export async function jobOf(id) {
  return (await shop.ask(`/v1/jobs/${id}?include=report`)).json();
}
