// A service and a browser, for all the tests of a file.
import { after, before } from "node:test";
import { launch } from "./browser.mjs";
import { serve } from "./service.mjs";

/** There while the tests run. */
export let service, browser;

before(async () => {
  service = await serve();
  browser = await launch();
});
after(async () => {
  await browser?.close();
  await service?.stop();
});
