import { useEffect, useRef } from "preact/hooks";
import { type Artifact, type Server, fetchArtifact } from "meshmend-client";

/**
 * A picture that the service drew; without a label, for decoration. It is drawn on a canvas: the request may need a key, and the shop's
 * Content-Security-Policy no `img-src`.
 */
export function Picture({ artifact, server, label }: { artifact: Artifact | undefined; server: Server; label: string | null }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => {
    const stop = new AbortController();
    const load = async (picture: Artifact): Promise<void> => {
      const bytes = await fetchArtifact(server, picture, stop.signal);
      const image = await createImageBitmap(new Blob([bytes], { type: picture.media_type }));
      const target = canvas.current;
      if (!target) return;
      [target.width, target.height] = [image.width, image.height];
      target.getContext("2d")?.drawImage(image, 0, 0);
    };
    // Without the picture, the texts remain.
    if (artifact) load(artifact).catch(() => undefined);
    return () => stop.abort();
  }, [artifact?.href]);
  if (!artifact) return null;
  return label === null ? <canvas ref={canvas} aria-hidden="true" /> : <canvas class="picture" ref={canvas} role="img" aria-label={label} />;
}
