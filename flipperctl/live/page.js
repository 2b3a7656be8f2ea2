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
