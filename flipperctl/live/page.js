// What the live pages share: the 3-D scene in its frame. Viser's own panel is hidden there. Where it
// is drawn in software, it is drawn coarser while it moves, so that keys are still heard at once.
const SOFTWARE = drawnInSoftware();
function drawnInSoftware() {
  const gl = document.createElement("canvas").getContext("webgl"), info = gl?.getExtension("WEBGL_debug_renderer_info");
  return !info || /swiftshader|llvmpipe|software/i.test(gl.getParameter(info.UNMASKED_RENDERER_WEBGL));
}
function embedScene(frame, loaded) {
  frame.addEventListener("load", () => {
    const inside = frame.contentWindow, style = inside.document.createElement("style");
    style.textContent = "body * { visibility: hidden } canvas { visibility: visible }";
    inside.document.head.append(style);
    loaded(inside);
  });
  frame.src = `/scene${SOFTWARE ? `?fixedDpr=${window.devicePixelRatio || 1}` : ""}`;
}
function sceneMoves(frame, moves) { frame.classList.toggle("coarse", SOFTWARE && moves); }
// What the marks of the scene are
const MARKS = [
  ["finish", "finish"], ["points", "points of the ground", "dot"], ["mean", "mean height of each bin"],
  ["highest", "highest point of each bin"], ["ray", "candidate angle of the front flippers"],
  ["plan", "path that a search plans"], ["map", "map of the lidar", "dot"],
];
function markLegend(marks) {
  return marks.map(([name, text, dot]) =>
    `<i class="mark ${dot ?? ""} ${name}" style="--hue: var(--${name})"></i><span class="${name}">${text}</span>`).join("");
}
