import { type RefObject } from "preact";
import { useEffect, useLayoutEffect, useState } from "preact/hooks";
import { type Unit, inMillimetres } from "../units";
import { type Point, distance } from "../viewer/distance";
import type { Viewer } from "../viewer/viewer";
import { usePageWords } from "../words/page-locale";
import { Icon } from "./icons";

/** A pointer that moves farther than this between down and up turns the model instead of picking a point; in pixels. */
const STILL = 6;

interface Props {
  viewer: Viewer;
  canvas: RefObject<HTMLCanvasElement | null>;
  /** The unit to show lengths in, and the unit of the model's numbers. */
  unit: Unit;
  modelUnit: string;
  close: () => void;
}

/** Measures the distance between two points, picked with a mouse, a finger or the keyboard. */
export function Ruler({ viewer, canvas, unit, modelUnit, close }: Props) {
  const { words, figures } = usePageWords();
  const [points, setPoints] = useState<Point[]>([]);
  const [isMissed, setMissed] = useState(false);
  const length = (value: number): string => figures.length(value * inMillimetres(modelUnit), unit, 4);
  const [a, b] = points;
  const measured = a && b ? distance(a, b) : null;

  const pick = (pointer: PointerEvent | null): void => {
    const point = viewer.pick(pointer);
    setMissed(point === null);
    if (point) setPoints((all) => (all.length === 2 ? [point] : [...all, point]));
  };
  const clear = (): void => {
    setPoints([]);
    setMissed(false);
  };
  // A layout effect runs before painting, so that the first key or click is not missed.
  useLayoutEffect(() => {
    const element = canvas.current;
    if (!element) return;
    let down: PointerEvent | null = null;
    const stop = new AbortController();
    const { signal } = stop;
    const isFocused = (): boolean => element.matches(":focus-visible");
    element.addEventListener("pointerdown", (event) => (down = event.isPrimary && event.button === 0 ? event : null), { signal });
    element.addEventListener(
      "pointerup",
      (event) => {
        if (down && Math.hypot(event.clientX - down.clientX, event.clientY - down.clientY) <= STILL) pick(event);
        down = null;
      },
      { signal },
    );
    element.addEventListener(
      "keydown",
      (event) => {
        viewer.showCross(true);
        if (event.key === "Enter" || event.key === " ") pick(null);
        else if (event.key === "Escape") clear();
        else return;
        event.preventDefault();
      },
      { signal },
    );
    element.addEventListener("focus", () => viewer.showCross(isFocused()), { signal });
    element.addEventListener("blur", () => viewer.showCross(false), { signal });
    return () => {
      stop.abort();
      viewer.showCross(false);
    };
  }, [viewer]);
  useEffect(() => {
    viewer.setRuler(points, measured ? length(measured.length) : "");
    return () => viewer.setRuler([], "");
  }, [viewer, points, unit, modelUnit, figures]);

  return (
    <div class="ruler" role="group" aria-label={words.ruler}>
      <div role="status">
        {measured ? (
          <>
            <p class="whole">{words.rulerIs(length(measured.length))}</p>
            <p class="along">
              {measured.along.map((part, k) => (
                <span key={k}>{words.rulerAlong("XYZ"[k]!, length(part))}</span>
              ))}
            </p>
          </>
        ) : (
          <p>{isMissed ? words.rulerMissed : points.length === 1 ? words.rulerSecond : words.rulerHelp}</p>
        )}
        {points.length === 0 && <p class="keys">{words.rulerKeys}</p>}
      </div>
      <div class="actions">
        <button type="button" class="plain" disabled={points.length === 0} onClick={clear}>
          {words.rulerClear}
        </button>
        <button type="button" class="quiet" onClick={close} title={words.close} aria-label={words.close}>
          <Icon name="cross" size={16} />
        </button>
      </div>
    </div>
  );
}
