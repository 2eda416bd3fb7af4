// What is loaded when there is something to look at.
export { readAppearance } from "./appearance/read";
export { readColouredMesh } from "./glb";
export { Viewer } from "./viewer";
