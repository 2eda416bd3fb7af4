// A service and a browser, for all the tests of a file.
import { launchBeside } from "./browser.mjs";
import { serve } from "./service.mjs";

// Awaited here rather than in a hook, since some versions of node begin all hooks of a file at once.
export const service = await serve();
export const browser = await launchBeside(service);
