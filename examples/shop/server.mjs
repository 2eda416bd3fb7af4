// A shop that prints its customers' models. Browsers send models straight to meshmend; this backend prices, sells and downloads them.
// See README.md.
import { randomUUID } from "node:crypto";
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { Webhook } from "standardwebhooks";
import * as meshmend from "./meshmend.mjs";
import * as orders from "./orders.mjs";
import { settings } from "./settings.mjs";

const read = (name) => readFileSync(new URL(`public/${name}`, import.meta.url), "utf8");
const files = {
  "/": ["text/html; charset=utf-8", read("index.html").replaceAll("{meshmend}", settings.meshmend)],
  "/shop.css": ["text/css; charset=utf-8", read("shop.css")],
  "/shop.mjs": ["text/javascript; charset=utf-8", read("shop.mjs")],
};
/** The widget needs its script, the service, and the service's bucket if there is one. */
const POLICY = [
  "default-src 'none'",
  `script-src 'self' ${settings.meshmend}`,
  `connect-src 'self' ${settings.meshmend} ${settings.bucket}`.trim(),
  "style-src 'self'",
  "img-src 'self'",
  "base-uri 'none'",
  "form-action 'none'",
  "frame-ancestors 'none'",
].join("; ");
const MOST_BYTES = 1_000_000;

async function bodyOf(request) {
  const pieces = [];
  let bytes = 0;
  for await (const piece of request) {
    bytes += piece.length;
    if (bytes > MOST_BYTES) throw Object.assign(new Error("too large"), { status: 413 });
    pieces.push(piece);
  }
  return Buffer.concat(pieces).toString("utf8");
}

/** Returns the customer of a request's session. Every visitor of the page gets a session. */
function customerOf(request) {
  return /(?:^|; )session=([\w-]+)/.exec(request.headers.cookie ?? "")?.[1] ?? null;
}

/** The page's requests for a customer. Each returns a status and a JSON value. */
const routes = {
  async "POST /meshmend-token"() {
    return [201, await meshmend.browserToken()];
  },
  async "POST /quotes"(customer, { jobId, choice }) {
    const quote = await orders.quote(customer, String(jobId), choice && String(choice));
    return quote.refusal ? [422, { message: quote.refusal }] : [201, quote];
  },
  async "POST /orders"(customer, { quoteId }) {
    const order = await orders.order(customer, String(quoteId));
    return order ? [201, order] : [404, { message: "This quote is not yours, or it was ordered before." }];
  },
  async "GET /orders"(customer, _, id) {
    const order = orders.find(customer, id);
    return order ? [200, order] : [404, { message: "There is no such order of yours." }];
  },
};

/** Receives a webhook from meshmend: signed, not older than five minutes, and handled once. */
async function hook(request) {
  const text = await bodyOf(request);
  let message;
  try {
    message = new Webhook(settings.webhookSecret).verify(text, request.headers);
  } catch {
    return [401, { message: "The signature is not meshmend's." }];
  }
  await orders.told(request.headers["webhook-id"], message);
  return [204, null];
}

async function answerTo(request, path) {
  if (request.method === "POST" && path === "/hooks/meshmend") return hook(request);
  const [, first, id] = path.split("/");
  const route = routes[`${request.method} /${first}`];
  if (!route) return [404, { message: "There is nothing here." }];
  const customer = customerOf(request);
  // Only the shop's own pages may act for a customer.
  const isOwn = request.method === "GET" || request.headers.origin === settings.origin;
  if (!customer || !isOwn) return [403, { message: "Load the shop's page first." }];
  const text = await bodyOf(request);
  return route(customer, text ? JSON.parse(text) : {}, id);
}

const server = createServer(async (request, response) => {
  const path = new URL(request.url, settings.origin).pathname;
  const headers = { "content-security-policy": POLICY, "x-content-type-options": "nosniff", "cache-control": "no-store" };
  const file = request.method === "GET" && files[path];
  if (file) {
    if (!customerOf(request)) headers["set-cookie"] = `session=${randomUUID()}; HttpOnly; SameSite=Lax; Path=/`;
    response.writeHead(200, { ...headers, "content-type": file[0] }).end(file[1]);
    return;
  }
  try {
    const [status, said] = await answerTo(request, path);
    response.writeHead(status, { ...headers, "content-type": "application/json" }).end(said === null ? "" : JSON.stringify(said));
  } catch (error) {
    console.error(request.method, path, error);
    response.writeHead(error.status === 413 ? 413 : 502, { ...headers, "content-type": "application/json" });
    response.end(JSON.stringify({ message: "Something went wrong on our side. Try again in a moment." }));
  }
});
server.listen(settings.port, "127.0.0.1", () => console.log(`The shop is at ${settings.origin}`));
