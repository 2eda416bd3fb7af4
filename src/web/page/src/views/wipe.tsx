import { useEffect, useState } from "preact/hooks";
import type { Viewer } from "../viewer/viewer";
import { useWords } from "../words/locale";

/** The handle between before and after. */
export function Wipe({ viewer }: { viewer: Viewer | null }) {
  const { words } = useWords();
  const [share, set] = useState(0.5);
  useEffect(() => viewer?.setWipe(share), [viewer, share]);
  const drag = (event: PointerEvent): void => {
    const handle = event.currentTarget as HTMLElement;
    if (event.type === "pointerdown") handle.setPointerCapture(event.pointerId);
    if (!handle.hasPointerCapture(event.pointerId)) return;
    const box = handle.parentElement!.getBoundingClientRect();
    set(Math.min(0.98, Math.max(0.02, (event.clientX - box.left) / box.width)));
  };
  const press = (event: KeyboardEvent): void => {
    const by = { ArrowLeft: -0.02, ArrowRight: 0.02, PageDown: -0.1, PageUp: 0.1 }[event.key];
    const to = { Home: 0.02, End: 0.98 }[event.key];
    if (by === undefined && to === undefined) return;
    event.preventDefault();
    set(Math.min(0.98, Math.max(0.02, to ?? share + by!)));
  };
  return (
    <div
      class="divider"
      role="slider"
      tabIndex={0}
      aria-label={words.wipe}
      aria-valuemin={0}
      aria-valuemax={100}
      aria-valuenow={Math.round(share * 100)}
      style={{ left: `${share * 100}%` }}
      onPointerDown={drag}
      onPointerMove={drag}
      onKeyDown={press}
    >
      <span class="grip" />
    </div>
  );
}
