import { useRef } from "preact/hooks";
import { endings } from "../state/files";
import { Icon } from "../views/icons";
import { useTexts } from "./texts";

/** Formats that every meshmend version reads. Asking the service for its formats needs a token, which is fetched only for an upload. */
export const FORMATS = ["stl", "obj", "ply", "off", "3mf", "glb", "zip"];

/** The area to drop a model on, with a button that opens the file dialog. */
export function DropZone({ accept, over, take }: { accept: string | null; over: boolean; take: (files: File[]) => void }) {
  const texts = useTexts();
  const input = useRef<HTMLInputElement>(null);
  const accepted = accept ?? endings(FORMATS).map((ending) => `.${ending}`).join(",");
  const chosen = (event: Event): void => {
    const input = event.currentTarget as HTMLInputElement;
    if (input.files?.length) take([...input.files]);
    input.value = "";
  };
  return (
    <div class={over ? "dropzone over" : "dropzone"} part={over ? "dropzone over" : "dropzone"}>
      <Icon name="upload" size={32} />
      <p class="big">{over ? texts.letGo : texts.dropHere}</p>
      <p class="small">{texts.orChoose}</p>
      <input ref={input} type="file" accept={accepted} hidden onChange={chosen} />
      <button type="button" class="primary" part="button primary" onClick={() => input.current?.click()}>
        {texts.choose}
      </button>
      <p class="small">{accept ?? FORMATS.map((format) => format.toUpperCase()).join(", ")}</p>
    </div>
  );
}
