// The shop's settings, from environment variables.
function needed(name) {
  const value = process.env[name];
  if (!value) throw new Error(`Set ${name}; README.md says how.`);
  return value;
}

export const settings = {
  port: Number(process.env.PORT ?? 3000),
  /** The shop's address in browsers. Tokens work only on its pages. */
  origin: process.env.SHOP_ORIGIN ?? `http://127.0.0.1:${process.env.PORT ?? 3000}`,
  /** Folder for ordered models. */
  folder: process.env.SHOP_FOLDER ?? new URL("orders", import.meta.url).pathname,
  meshmend: (process.env.MESHMEND_URL ?? "http://127.0.0.1:8080").replace(/\/+$/, ""),
  /** Origin of meshmend's bucket for browsers, if meshmend has one. */
  bucket: process.env.MESHMEND_BUCKET ?? "",
  /** The key and the secret never leave the backend. */
  key: needed("MESHMEND_API_KEY"),
  webhookSecret: needed("MESHMEND_WEBHOOK_SECRET"),
};
