// What the shop is told by its environment.
function needed(name) {
  const value = process.env[name];
  if (!value) throw new Error(`Set ${name}; README.md says how.`);
  return value;
}

export const settings = {
  port: Number(process.env.PORT ?? 3000),
  /** The shop's own address, as browsers have it: tokens are for its pages and no others. */
  origin: process.env.SHOP_ORIGIN ?? `http://127.0.0.1:${process.env.PORT ?? 3000}`,
  /** Where bought models go. */
  folder: process.env.SHOP_FOLDER ?? new URL("orders", import.meta.url).pathname,
  meshmend: (process.env.MESHMEND_URL ?? "http://127.0.0.1:8080").replace(/\/+$/, ""),
  /** Where browsers reach the bucket that meshmend keeps files in, if it has one. */
  bucket: process.env.MESHMEND_BUCKET ?? "",
  /** These two never leave the backend. */
  key: needed("MESHMEND_API_KEY"),
  webhookSecret: needed("MESHMEND_WEBHOOK_SECRET"),
};
