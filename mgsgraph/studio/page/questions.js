export function panel(app, element) { element.textContent = 'Select a point on the map.'; return {}; }
