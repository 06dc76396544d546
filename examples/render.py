"""Draws convex bodies with numpy and Pillow: a z-buffer, shadows, outlines and contact points.

Points are in the world frame, with z up. A body is a list of faces. A face is an array of its
corners (k, 3), anticlockwise seen from outside.
"""

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

BACKGROUND = np.array([246, 247, 249])
INK = (38, 43, 51)
_OVERSAMPLING = 2
_LIGHT = np.array([0.35, -0.5, 0.8])
_SHADOW_PIXELS = 1400


@dataclass
class Camera:
    """A camera at `eye` that looks at `target`.

    `lens` is the focal length over the picture's height.
    """

    eye: tuple
    target: tuple
    lens: float = 1.6

    def axes(self):
        """The rows are the directions right, down and forward."""
        forward = np.subtract(self.target, self.eye).astype(float)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(forward, right), forward])


class View:
    """A camera with a picture of width x height pixels.

    It maps world points to pixels and 1/depth.
    """

    def __init__(self, camera, width, height):
        self.width, self.height = width, height
        self._eye, self._axes = np.array(camera.eye, float), camera.axes()
        self._focus = camera.lens * height

    def project(self, points):
        """(n, 3): pixel x, pixel y, 1/depth."""
        local = (points - self._eye) @ self._axes.T
        inverse = 1 / local[:, 2]
        centre = np.array([self.width, self.height]) / 2
        return np.column_stack([local[:, :2] * inverse[:, None] * self._focus + centre, inverse])

    def faces_it(self, normal, point):
        return normal @ (self._eye - point) > 0

    def plane(self, normal, point):
        """A plane's 1/depth, as coefficients (a, b, c) of a x + b y + c at pixel (x, y)."""
        a, b, c = self._axes @ normal / (normal @ (point - self._eye))
        return a / self._focus, b / self._focus, c - (a * self.width + b * self.height) / 2 / self._focus

    def world(self, inverse):
        """The world points seen at the pixels, from their 1/depth."""
        y, x = np.indices(inverse.shape) + 0.5
        ray = np.stack([x - self.width / 2, y - self.height / 2, np.full(x.shape, self._focus)], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return self._eye + (ray / self._focus / inverse[..., None]) @ self._axes


class Sun:
    """The light's orthographic view of some points.

    Nearer points have a larger depth, as with 1/depth.
    """

    def __init__(self, points):
        light = _LIGHT / np.linalg.norm(_LIGHT)
        right = np.cross(light, [0, 0, 1])
        right /= np.linalg.norm(right)
        self._axes = np.array([right, np.cross(light, right), light])
        local = points @ self._axes.T
        self._low = local.min(axis=0)
        self._scale = (_SHADOW_PIXELS - 4) / np.ptp(local[:, :2], axis=0).max()
        self.width = self.height = _SHADOW_PIXELS
        self.bias = 3 / self._scale

    def project(self, points):
        local = points @ self._axes.T
        local[:, :2] = (local[:, :2] - self._low[:2]) * self._scale + 2
        return local

    def faces_it(self, normal, _point):
        return normal @ self._axes[2] > 0

    def plane(self, normal, point):
        n, p = self._axes @ normal, self.project(point[None])[0]
        a, b = -n[0] / n[2] / self._scale, -n[1] / n[2] / self._scale
        return a, b, p[2] - a * p[0] - b * p[1]


def rasterise(view, faces, normals):
    """The nearest face at every pixel (-1 for none), and its depth in the view's measure."""
    depth = np.full((view.height, view.width), -np.inf)
    nearest = np.full(depth.shape, -1, np.int32)
    for index, (corners, normal) in enumerate(zip(faces, normals)):
        if not view.faces_it(normal, corners[0]):
            continue
        polygon = view.project(corners)[:, :2]
        x0, y0 = np.maximum(np.floor(polygon.min(axis=0)).astype(int), 0)
        x1 = min(int(polygon[:, 0].max()) + 1, view.width)
        y1 = min(int(polygon[:, 1].max()) + 1, view.height)
        if x0 >= x1 or y0 >= y1:
            continue
        x, y = np.arange(x0, x1) + 0.5, np.arange(y0, y1)[:, None] + 0.5
        edges = np.roll(polygon, -1, axis=0) - polygon
        turn = np.sign(edges[:, 0] @ np.roll(edges[:, 1], -1) - edges[:, 1] @ np.roll(edges[:, 0], -1))
        inside = np.ones((y1 - y0, x1 - x0), bool)
        for (px, py), (ex, ey) in zip(polygon, turn * edges):
            inside &= ex * (y - py) >= ey * (x - px)
        a, b, c = view.plane(normal, corners[0])
        value = a * x + (b * y + c)
        window = depth[y0:y1, x0:x1]
        inside &= value > window
        window[inside] = value[inside]
        nearest[y0:y1, x0:x1][inside] = index
    return nearest, depth


def draw(bodies, colours, camera, size):
    """Draws the bodies; returns the picture, its View, and the 1/depth of every pixel.

    `colours` has one RGB colour per body. The 1/depth is -inf where nothing is drawn.
    """
    width, height = size
    view = View(camera, width * _OVERSAMPLING, height * _OVERSAMPLING)
    faces = [np.asarray(face) for body in bodies for face in body]
    owner = np.repeat(np.arange(len(bodies)), [len(body) for body in bodies])
    normals = np.array([_normal(face) for face in faces])
    nearest, depth = rasterise(view, faces, normals)
    lit = _sunlight(faces, normals, view, nearest, depth)
    light = _LIGHT / np.linalg.norm(_LIGHT)
    shade = 0.60 + 0.12 * normals[:, 2] + 0.06 * normals[:, 0]
    shade = shade[nearest] + 0.36 * lit * np.maximum(normals @ light, 0)[nearest]
    image = np.asarray(colours, float)[owner[nearest]] * shade[..., None]
    image[nearest < 0] = BACKGROUND
    for strength, label in ((0.72, nearest), (0.55, np.where(nearest < 0, -1, owner[nearest]))):
        line = np.zeros(label.shape, bool)
        line[:, 1:] |= label[:, 1:] != label[:, :-1]
        line[1:] |= label[1:] != label[:-1]
        image[line] *= strength
    picture = Image.fromarray(np.clip(image, 0, 255).astype(np.uint8))
    picture = picture.resize((width, height), Image.Resampling.BOX)
    return picture, View(camera, width, height), depth[::_OVERSAMPLING, ::_OVERSAMPLING]


def _normal(corners):
    """Newell's normal, which is accurate for any convex polygon, however close its corners are."""
    following = np.roll(corners, -1, axis=0)
    normal = np.cross(corners - corners[0], following - corners[0]).sum(axis=0)
    return normal / np.linalg.norm(normal)


def _sunlight(faces, normals, view, nearest, depth):
    """The share of the light, 0 to 1, that reaches every pixel, softened over 3 x 3 texels."""
    sun = Sun(np.concatenate(faces))
    _, shadow = rasterise(sun, faces, normals)
    seen = nearest >= 0
    texels = sun.project(view.world(depth)[seen])
    lit = np.zeros(texels.shape[0])
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            column = np.clip((texels[:, 0] + dx).astype(int), 0, sun.width - 1)
            row = np.clip((texels[:, 1] + dy).astype(int), 0, sun.height - 1)
            lit += texels[:, 2] + sun.bias >= shadow[row, column]
    share = np.zeros(nearest.shape)
    share[seen] = lit / 9
    return share


def draw_contacts(picture, view, depth, points, normals, colours, length, radius, hidden):
    """Draws contact points as dots of `radius` pixels, normals as lines of `length` world units.

    A contact behind a body is drawn with the opacity `hidden`, 0 to 1.
    """
    layer = Image.new("RGBA", (picture.width * 2, picture.height * 2))
    pen = ImageDraw.Draw(layer)
    start, end = view.project(points), view.project(points + length * normals)
    column = np.clip(start[:, 0].astype(int), 0, view.width - 1)
    row = np.clip(start[:, 1].astype(int), 0, view.height - 1)
    visible = start[:, 2] >= depth[row, column] * 0.995
    for i in np.lexsort((start[:, 2], visible)):
        alpha = 255 if visible[i] else int(255 * hidden)
        colour = (*(int(c) for c in colours[i]), alpha)
        (x0, y0), (x1, y1), r = 2 * start[i, :2], 2 * end[i, :2], 2 * radius
        pen.line([(x0, y0), (x1, y1)], fill=(*INK, alpha), width=max(int(radius), 2))
        pen.ellipse([x0 - r, y0 - r, x0 + r, y0 + r], fill=colour, outline=(*INK, alpha), width=max(int(r / 4), 1))
    layer = layer.resize(picture.size, Image.Resampling.BOX)
    return Image.alpha_composite(picture.convert("RGBA"), layer).convert("RGB")


_STOPS = np.array([0, 0.5, 1.0])
_RAMP = np.array([[43, 120, 228], [255, 205, 52], [214, 40, 40]])


def ramp(values):
    """RGB rows for values from 0 to 1: blue, yellow, red."""
    values = np.clip(values, 0, 1)
    return np.column_stack([np.interp(values, _STOPS, _RAMP[:, c]) for c in range(3)])


def font(size):
    """Pillow's own scalable font."""
    return ImageFont.load_default(size)


def colour_bar(width, height, low, high, title):
    """The legend of `ramp`, with labels at its ends."""
    bar = Image.new("RGB", (width, height), tuple(int(c) for c in BACKGROUND))
    pen, text = ImageDraw.Draw(bar), font(15)
    strip = ramp(np.linspace(0, 1, width)).astype(np.uint8)
    bar.paste(Image.fromarray(np.repeat(strip[None], 12, axis=0)), (0, 24))
    pen.text((0, 0), title, fill=INK, font=text)
    pen.text((0, 40), low, fill=INK, font=text)
    pen.text((width, 40), high, fill=INK, font=text, anchor="ra")
    return bar
