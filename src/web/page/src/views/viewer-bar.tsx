import { type RefObject } from "preact";
import { useEffect, useState } from "preact/hooks";
import { type Unit, UNITS, inMillimetres } from "../units";
import { choose, settings } from "../state/settings";
import type { Mode } from "../viewer/layout";
import type { Axis } from "../viewer/viewer";
import { usePageWords } from "../words/page-locale";
import { Icon } from "./icons";
import { useStore } from "./use-store";
import type { Shown } from "./viewer-pane";

interface Props {
  shown: Shown | null;
  mode: Mode;
  setMode: (mode: Mode) => void;
  hasAfter: boolean;
  box: RefObject<HTMLElement | null>;
  /** The unit of the model's numbers. */
  unit: string;
  /** Whether a model has original colours. */
  hasColours: boolean;
  isMeasuring: boolean;
  setMeasuring: (isOn: boolean) => void;
}

/** The viewer's toolbar. */
export function ViewerBar({ shown, mode, setMode, hasAfter, box, unit: modelUnit, hasColours, isMeasuring, setMeasuring }: Props) {
  const { words, figures } = usePageWords();
  const { unit } = useStore(settings);
  const [wire, setWire] = useState(false);
  const [sizes, setSizes] = useState(false);
  const [isColoured, setColoured] = useState(true);
  const [axis, setAxis] = useState<Axis | null>(null);
  const [cut, setCut] = useState(0.5);
  const viewer = shown?.viewer;
  useEffect(() => viewer?.setWire(wire), [viewer, wire]);
  useEffect(() => viewer?.showColours(isColoured), [viewer, isColoured]);
  useEffect(() => viewer?.setCut(axis, cut), [viewer, axis, cut, shown]);
  useEffect(() => {
    const frame = viewer?.frame;
    const text = (k: 0 | 1 | 2): string => figures.length((frame!.max[k] - frame!.min[k]) * inMillimetres(modelUnit), unit);
    viewer?.setSizes(sizes && frame ? [text(0), text(1), text(2)] : null);
  }, [viewer, sizes, unit, modelUnit, figures, shown]);
  const full = (): void => {
    if (document.fullscreenElement) void document.exitFullscreen();
    else void box.current?.requestFullscreen?.();
  };
  const modes: Mode[] = ["both", "wipe", "before", "after"];
  return (
    <div class="viewer-bar" role="toolbar" aria-label={words.viewer}>
      {hasAfter && (
        <div class="segments" role="group">
          {modes.map((option) => (
            <button key={option} type="button" aria-pressed={mode === option} onClick={() => setMode(option)}>
              {words.modes[option]}
            </button>
          ))}
        </div>
      )}
      <div class="group">
        <button type="button" class="quiet" aria-pressed={wire} onClick={() => setWire(!wire)} title={words.wire}>
          <Icon name="wire" /> <span class="word">{words.wire}</span>
        </button>
        <button type="button" class="quiet" aria-pressed={sizes} onClick={() => setSizes(!sizes)} title={words.sizes}>
          <Icon name="ruler" /> <span class="word">{words.sizes}</span>
        </button>
        <button type="button" class="quiet" aria-pressed={isMeasuring} onClick={() => setMeasuring(!isMeasuring)} title={words.ruler} aria-label={words.ruler}>
          <Icon name="distance" />
        </button>
        {hasColours && (
          <button type="button" class="quiet" aria-pressed={isColoured} onClick={() => setColoured(!isColoured)} title={words.ownColours} aria-label={words.ownColours}>
            <Icon name="palette" />
          </button>
        )}
        <select class="quiet" aria-label={words.unit} value={unit} onChange={(event) => choose({ unit: event.currentTarget.value as Unit })}>
          {UNITS.map((it) => (
            <option key={it}>{it}</option>
          ))}
        </select>
        <label class="section-choice" title={words.section}>
          <Icon name="slice" />
          <select class="quiet" aria-label={words.section} value={axis ?? ""} onChange={(event) => setAxis((event.currentTarget.value || null) as Axis | null)}>
            <option value="">{words.section}</option>
            <option value="x">X</option>
            <option value="y">Y</option>
            <option value="z">Z</option>
          </select>
        </label>
        {axis && (
          <input type="range" class="cut" min={0} max={1} step={0.005} value={cut} aria-label={words.sectionAt} onInput={(event) => setCut(Number(event.currentTarget.value))} />
        )}
        <button type="button" class="quiet" onClick={() => viewer?.home()} title={words.home} aria-label={words.home}>
          <Icon name="home" />
        </button>
        <button type="button" class="quiet full" onClick={full} title={words.fullscreen} aria-label={words.fullscreen}>
          <Icon name="full" />
        </button>
      </div>
    </div>
  );
}
