// Exports of the viewer script, which is loaded when there is a model to show.
export { readAppearance } from "./appearance/read";
export { readColouredMesh } from "./glb";
export { Viewer } from "./viewer";
