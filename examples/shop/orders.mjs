// Quotes and orders, in memory to keep the example small. A real shop uses a database.
import { randomUUID } from "node:crypto";
import { basename, join } from "node:path";
import * as meshmend from "./meshmend.mjs";
import { DEFAULT, modelOf, priceOf } from "./prices.mjs";
import { settings } from "./settings.mjs";

const quotes = new Map();
const orders = new Map();
/** The webhooks of ended jobs, by job. A webhook may arrive before or after the order. */
const ended = new Map();
/** Webhooks that were or are being handled, by webhook-id. The same webhook may arrive twice. */
const messages = new Map();

/** Quotes one of a job's results for a customer. */
export async function quote(customer, jobId, choice = DEFAULT) {
  const { refusal, ...price } = priceOf(await meshmend.job(jobId), choice);
  if (refusal) return { refusal };
  const id = randomUUID();
  quotes.set(id, { id, customer, jobId, choice, ...price });
  return { id, ...price };
}

/** Orders a model that was quoted to this customer. */
export async function order(customer, quoteId) {
  const found = quotes.get(quoteId);
  if (found?.customer !== customer) return null;
  quotes.delete(quoteId);
  const { jobId, choice, cents } = found;
  const made = { id: randomUUID(), customer, jobId, choice, cents, status: "received", file: null };
  orders.set(made.id, made);
  if (ended.has(made.jobId)) await produce(made, ended.get(made.jobId)).catch((error) => console.error(`order ${made.id}:`, error));
  return view(made);
}

export function find(customer, id) {
  const found = orders.get(id);
  return found?.customer === customer ? view(found) : null;
}

function view({ id, status, cents, file }) {
  return { id, status, cents, file: file && basename(file) };
}

/** Handles a verified webhook once, however often it arrives. A failed one is forgotten, so that its retry is handled. */
export async function told(messageId, message) {
  if (!messages.has(messageId)) messages.set(messageId, handle(message));
  try {
    await messages.get(messageId);
  } catch (error) {
    messages.delete(messageId);
    throw error;
  }
}

async function handle({ type, data }) {
  if (type !== "job.succeeded" || !data.printable) return;
  ended.set(data.id, data);
  for (const it of orders.values()) if (it.jobId === data.id) await produce(it, data);
}

/** Downloads the model of an order for the workshop. */
async function produce(it, { id, artifacts }) {
  if (it.status !== "received") return;
  const { filename } = modelOf(await meshmend.job(id), it.choice);
  const file = join(settings.folder, it.id, basename(filename));
  await meshmend.download(modelOf({ artifacts }, it.choice), file);
  Object.assign(it, { status: "in production", file });
}
