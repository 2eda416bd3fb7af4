// An S3-compatible bucket on another origin, with the CORS rules that the documentation recommends.
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import S3rver from "s3rver";

const NAME = "models";
/** URLs are signed, so any page that has one may use it; the rules in docs/operations.md are narrower. */
const CORS = `<CORSConfiguration><CORSRule>
  <AllowedOrigin>*</AllowedOrigin><AllowedMethod>GET</AllowedMethod><AllowedMethod>PUT</AllowedMethod><AllowedHeader>*</AllowedHeader>
</CORSRule></CORSConfiguration>`;

/** Starts a bucket; `args` are the service's arguments for it. */
export async function bucket({ cors = CORS } = {}) {
  const directory = mkdtempSync(join(tmpdir(), "meshmend-bucket-"));
  const server = new S3rver({
    directory,
    address: "127.0.0.1",
    port: 0,
    silent: true,
    configureBuckets: [{ name: NAME, configs: cors ? [cors] : [] }],
  });
  const { port } = await server.run();
  const url = `http://127.0.0.1:${port}`;
  const args = ["--blob-url", `s3://${NAME}`, "--s3-endpoint", url, "--s3-allow-http", "true", "--presigned-downloads", "true"];
  const keys = ["--s3-access-key-id", "S3RVER", "--s3-secret-access-key", "S3RVER"];
  const stop = async () => {
    await server.close();
    rmSync(directory, { recursive: true, force: true });
  };
  return { url, args: [...args, ...keys], stop };
}
