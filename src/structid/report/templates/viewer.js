// Opens a figure in the whole window: zoom by wheel, pinch or buttons; drag to move; read values at the pointer.
// The page is complete without this script.
(() => {
  const viewer = document.createElement("dialog");
  viewer.className = "viewer";
  viewer.innerHTML = `<div class="stage"><img alt=""></div><p class="read" aria-live="polite"></p><div class="tools">
    <button data-zoom="1.5" aria-label="Zoom in">+</button><button data-zoom="0.6667" aria-label="Zoom out">−</button>
    <button data-fit>Fit</button><a download>Save</a><button data-close>Close</button></div>`;
  document.body.append(viewer);
  const stage = viewer.querySelector(".stage"), image = stage.firstElementChild;
  const read = viewer.querySelector(".read"), save = viewer.querySelector("a");
  const pointers = new Map();
  let place = { x: 0, y: 0, width: 1 }, ratio = 1, panels = [];

  function show() {
    image.style.width = `${place.width}px`;
    image.style.left = `${place.x}px`;
    image.style.top = `${place.y}px`;
  }
  function fit() {
    const { clientWidth: w, clientHeight: h } = stage;
    const width = Math.min(w, h / ratio);
    place = { x: (w - width) / 2, y: (h - width * ratio) / 2, width };
    show();
  }
  function zoom(by, x, y) {
    const width = Math.min(Math.max(place.width * by, 100), 60000), share = width / place.width;
    place = { x: x - (x - place.x) * share, y: y - (y - place.y) * share, width };
    show();
  }
  // Value at a relative position on a linear or logarithmic axis.
  const between = ([first, last], share, logarithmic) =>
    logarithmic ? first * (last / first) ** share : first + (last - first) * share;
  function valuesAt(x, y) {
    const across = (x - place.x) / place.width, down = (y - place.y) / (place.width * ratio);
    const panel = panels.find((p) => across >= p.left && across <= p.left + p.width && down >= p.top && down <= p.top + p.height);
    if (!panel) return "";
    const shares = [(across - panel.left) / panel.width, 1 - (down - panel.top) / panel.height];
    return [panel.x, panel.y].map((ends, k) => {
      const value = between(ends, shares[k], panel.logarithmic[k]);
      return `${panel.names[k] || "xy"[k]}: ${Number(value.toPrecision(4))}`;
    }).join("   ");
  }
  function open(figure) {
    panels = JSON.parse(figure.dataset.panels);
    image.src = save.href = figure.src;
    image.alt = figure.alt;
    save.download = `${figure.dataset.name}.svg`;
    ratio = figure.naturalHeight / figure.naturalWidth;
    read.textContent = "";
    viewer.showModal();
    fit();
  }
  for (const figure of document.querySelectorAll('figure img[data-panels]:not([data-panels="[]"])')) {
    figure.tabIndex = 0;
    figure.setAttribute("role", "button");
    figure.title = "Open to zoom and read values";
    figure.addEventListener("click", () => open(figure));
    figure.addEventListener("keydown", (event) => { if (event.key === "Enter") open(figure); });
  }
  viewer.addEventListener("click", ({ target }) => {
    if (target.dataset.zoom) zoom(Number(target.dataset.zoom), stage.clientWidth / 2, stage.clientHeight / 2);
    if ("fit" in target.dataset) fit();
    if ("close" in target.dataset) viewer.close();
  });
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), event.offsetX + (event.target === image ? place.x : 0), event.offsetY + (event.target === image ? place.y : 0));
  }, { passive: false });
  stage.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    stage.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
  });
  const middle = (all) => [all.reduce((s, p) => s + p.clientX, 0) / all.length, all.reduce((s, p) => s + p.clientY, 0) / all.length];
  const apart = ([a, b]) => Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  stage.addEventListener("pointermove", (event) => {
    read.textContent = valuesAt(event.clientX, event.clientY);
    if (!pointers.has(event.pointerId)) return;
    const before = [...pointers.values()];
    pointers.set(event.pointerId, event);
    const now = [...pointers.values()], [x, y] = middle(now), [fromX, fromY] = middle(before);
    place = { ...place, x: place.x + x - fromX, y: place.y + y - fromY };
    if (now.length === 2) zoom(apart(now) / apart(before), x, y);
    show();
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, (event) => pointers.delete(event.pointerId));
  stage.addEventListener("dblclick", fit);
  window.addEventListener("resize", () => { if (viewer.open) fit(); });
})();
