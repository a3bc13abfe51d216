"""Light that skin, eyes, teeth and lashes send to the camera: the compiled loops of `render`."""

from __future__ import annotations

import numpy as np
from numba import njit

from .srgb import linear_from_srgb

#: Part codes of the shading loop.
SKIN, EYE, EYE_LEFT, LASH, TEETH, TONGUE = range(6)
#: Colours of the lights; where they stand is in `stage_lights`.
_KEY_COLOUR = np.array([1.00, 0.92, 0.83]) * 2.75
_FILL_COLOUR = np.array([0.80, 0.90, 1.00]) * 0.36
_RIM_COLOUR = np.array([0.85, 0.93, 1.00]) * 1.5
_SKY_COLOUR = np.array([0.94, 0.97, 1.03]) * 0.37
_GROUND_COLOUR = np.array([1.0, 0.86, 0.78]) * 0.18
_EXPOSURE = 1.0
_SHOULDER = 0.5  # of white: light above is compressed
#: Linear light of each sRGB value.
LINEAR_OF_SRGB = linear_from_srgb(np.arange(256)).astype(np.float32)


@njit(cache=True)
def vertex_normals(v, triangles):  # type: ignore[no-untyped-def]
    """Area-weighted unit normals (V, 3)."""
    n = np.zeros_like(v)
    for f in range(len(triangles)):
        a, b, c = triangles[f]
        e0, e1, e2 = v[b, 0] - v[a, 0], v[b, 1] - v[a, 1], v[b, 2] - v[a, 2]
        g0, g1, g2 = v[c, 0] - v[a, 0], v[c, 1] - v[a, 1], v[c, 2] - v[a, 2]
        x, y, z = e1 * g2 - e2 * g1, e2 * g0 - e0 * g2, e0 * g1 - e1 * g0
        for k in (a, b, c):
            n[k, 0] += x
            n[k, 1] += y
            n[k, 2] += z
    for i in range(len(n)):
        length = np.sqrt(n[i, 0] ** 2 + n[i, 1] ** 2 + n[i, 2] ** 2)
        if length > 0:
            n[i] /= length
    return n


@njit(cache=True, nogil=True)
def shade_rows(  # type: ignore[no-untyped-def]
    triangle, weights, lash, directions, triangles, uv_triangles, uv, part, normals, lamps, sky,
    eye_light, axes, skin, roughness, eye, details, linear, lights, n_side, light_out, cover_out,
    first_row, last_row,
):  # fmt: skip
    """Light (premultiplied) and coverage of rows of pixels."""
    # one loop: cut into functions, even inlined ones, it was measured a third slower
    albedo, n = np.zeros(3, np.float32), np.zeros(3, np.float32)
    view, shine = np.zeros(3, np.float32), np.zeros(3, np.float32)
    lash_colour = np.zeros(3, np.float32)
    _texel(details[:, :, :3], linear, 0.5, 0.1, lash_colour)
    for y in range(first_row, last_row):
        for x in range(light_out.shape[1]):
            sum0, sum1, sum2, cover = 0.0, 0.0, 0.0, 0.0
            for s in range(n_side * n_side):
                j, i = y * n_side + s // n_side, x * n_side + s % n_side
                hidden = lash[j, i]
                f = triangle[j, i]
                if f == 4294967295:
                    cover += hidden
                    sum0 += hidden * lash_colour[0]
                    sum1 += hidden * lash_colour[1]
                    sum2 += hidden * lash_colour[2]
                    continue
                w1, w2 = weights[j, i, 0], weights[j, i, 1]
                w0 = 1 - w1 - w2
                a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
                ta, tb, tc = uv_triangles[f, 0], uv_triangles[f, 1], uv_triangles[f, 2]
                u = w0 * uv[ta, 0] + w1 * uv[tb, 0] + w2 * uv[tc, 0]
                v = w0 * uv[ta, 1] + w1 * uv[tb, 1] + w2 * uv[tc, 1]
                length = 0.0
                for k in range(3):
                    n[k] = w0 * normals[a, k] + w1 * normals[b, k] + w2 * normals[c, k]
                    view[k] = -directions[j, i, k]
                    length += n[k] * n[k]
                length = np.sqrt(max(length, 1e-12))
                for k in range(3):
                    n[k] /= length
                nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
                kind = part[f]
                # rounded barycentric weights may be just below 0, and powers are taken below
                lit = max(w0 * lamps[a, 0] + w1 * lamps[b, 0] + w2 * lamps[c, 0], 0.0)
                rim_lit = max(w0 * lamps[a, 1] + w1 * lamps[b, 1] + w2 * lamps[c, 1], 0.0)
                open_ = max(w0 * sky[a] + w1 * sky[b] + w2 * sky[c], 0.0)
                wrap_r, wrap_gb, f0, rough, gain = 0.30, 0.12, 0.028, 0.5, 1.0
                if kind == SKIN:
                    _texel(skin, linear, u, v, albedo)
                    rx = min(int(u * roughness.shape[1]), roughness.shape[1] - 1)
                    ry = min(int((1 - v) * roughness.shape[0]), roughness.shape[0] - 1)
                    rough = roughness[max(ry, 0), max(rx, 0)] / 255.0
                    gain = 1.0 - 0.6 * max(rough - 0.6, 0.0) / 0.4
                elif kind <= EYE_LEFT:
                    _texel(eye, linear, u, v, albedo)
                    lit = eye_light[j, i]
                    lit = 0.18 + 0.82 * lit * lit
                    open_ = lit
                    wrap_r, wrap_gb, f0, rough = 0.35, 0.30, 0.03, 0.10
                else:
                    _texel(details[:, :, :3], linear, u, v, albedo)
                    wrap_r, wrap_gb, f0, rough = 0.35, 0.25, 0.04, 0.28
                    if kind == TEETH:
                        lit *= np.sqrt(open_)
                if nv < 0 and kind == SKIN:  # the inside of the cut neck
                    albedo[0] *= 0.05
                    albedo[1] *= 0.05
                    albedo[2] *= 0.05
                lit_r = lit**0.75  # blood carries red light into the shadow
                nk = n[0] * lights[0, 0] + n[1] * lights[0, 1] + n[2] * lights[0, 2]
                nf = n[0] * lights[1, 0] + n[1] * lights[1, 1] + n[2] * lights[1, 2]
                nr = n[0] * lights[2, 0] + n[1] * lights[2, 1] + n[2] * lights[2, 2]
                up = n[0] * lights[3, 0] + n[1] * lights[3, 1] + n[2] * lights[3, 2]
                key_r = max(0.0, (nk + wrap_r) / (1 + wrap_r)) * lit_r
                key_g = max(0.0, (nk + wrap_gb) / (1 + wrap_gb)) * lit
                fill = max(0.0, (nf + 0.3) / 1.3) * open_
                rim = max(0.0, nr) * rim_lit * (1 - min(max(nv, 0.0), 1.0)) ** 1.5
                sky_share = 0.5 + 0.5 * up
                # light that bounces within a hollow takes the skin's colour (Jimenez et al. 2016)
                for k in range(3):
                    shade = open_
                    if kind == SKIN or kind > EYE_LEFT:
                        q = albedo[k]
                        bounce = ((2.0404 * q - 0.3324) * open_ - 4.7951 * q + 0.6417) * open_
                        shade = max(open_, (bounce + 2.7552 * q + 0.6903) * open_)
                    around = (
                        _SKY_COLOUR[k] * sky_share + _GROUND_COLOUR[k] * (1 - sky_share)
                    ) * shade
                    direct = _KEY_COLOUR[k] * (key_r if k == 0 else key_g)
                    direct += _FILL_COLOUR[k] * fill + _RIM_COLOUR[k] * rim
                    shine[k] = albedo[k] * (direct * 0.3183 * 1.15 + around)
                if kind in (EYE, EYE_LEFT):
                    # the cornea bulges: its normal turns faster than the ball's
                    axis = axes[kind - EYE]
                    turn = 0.0
                    for k in range(3):
                        turn += n[k] * axis[k]
                    dome = min(max((turn - 0.86) / 0.06, 0.0), 1.0)
                    length = 0.0
                    for k in range(3):
                        n[k] = axis[k] + (n[k] - axis[k]) * (1 + 0.75 * dome)
                        length += n[k] * n[k]
                    for k in range(3):
                        n[k] /= np.sqrt(length)
                    glint = _window(n, view, lights[0]) * dome * lit
                    wet = _highlight(n, view, lights[0], 0.20, 0.03) * lit * (1 - dome) * 0.5
                    flare = _highlight(n, view, lights[1], 0.22, 0.03) * lit
                    for k in range(3):
                        shine[k] += 0.85 * glint + _KEY_COLOUR[k] * wet + _FILL_COLOUR[k] * flare
                else:
                    first = _highlight(n, view, lights[0], rough, f0) * lit
                    second = _highlight(n, view, lights[1], rough, f0) * open_ * open_
                    third = _highlight(n, view, lights[2], rough, f0) * rim_lit * 0.8
                    for k in range(3):
                        shine[k] += gain * (
                            _KEY_COLOUR[k] * first
                            + _FILL_COLOUR[k] * second
                            + _RIM_COLOUR[k] * third
                        )
                    edge = (1 - min(max(nv, 0.0), 1.0)) ** 4 * 0.06 * open_ * gain
                    for k in range(3):
                        shine[k] += _SKY_COLOUR[k] * edge
                for k in range(3):
                    q = shine[k] * _EXPOSURE
                    if q > _SHOULDER:  # nothing clips hard
                        q = 1 - (1 - _SHOULDER) * np.exp((_SHOULDER - q) / (1 - _SHOULDER))
                    shine[k] = q * (1 - hidden) + hidden * lash_colour[k]
                sum0 += shine[0]
                sum1 += shine[1]
                sum2 += shine[2]
                cover += 1.0
            count = n_side * n_side
            light_out[y, x, 0] = sum0 / count
            light_out[y, x, 1] = sum1 / count
            light_out[y, x, 2] = sum2 / count
            cover_out[y, x] = cover / count


@njit(cache=True, nogil=True, inline="always")
def _texel(picture, linear, u, v, out):  # type: ignore[no-untyped-def]
    """Bilinear lookup in linear light; v counts from the bottom."""
    height, width = picture.shape[0], picture.shape[1]
    x = min(max(u * width - 0.5, 0.0), width - 1.001)
    y = min(max((1 - v) * height - 0.5, 0.0), height - 1.001)
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    for c in range(3):
        top = linear[picture[j, i, c]] * (1 - fx) + linear[picture[j, i + 1, c]] * fx
        low = linear[picture[j + 1, i, c]] * (1 - fx) + linear[picture[j + 1, i + 1, c]] * fx
        out[c] = top * (1 - fy) + low * fy


@njit(cache=True, nogil=True, inline="always")
def _highlight(n, view, light, roughness, f0):  # type: ignore[no-untyped-def]
    """Cook-Torrance with GGX (Walter et al. 2007), times the cosine to the light."""
    nl = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
    nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
    if nl <= 0 or nv <= 0:
        return 0.0
    h0, h1, h2 = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    length = np.sqrt(h0 * h0 + h1 * h1 + h2 * h2)
    nh = (n[0] * h0 + n[1] * h1 + n[2] * h2) / length
    vh = (view[0] * h0 + view[1] * h1 + view[2] * h2) / length
    a2 = roughness**4
    d = nh * nh * (a2 - 1) + 1
    k = 0.5 * roughness * roughness
    shadow = 1 / ((nl * (1 - k) + k) * (nv * (1 - k) + k) * 4)
    fresnel = f0 + (1 - f0) * (1 - vh) ** 5
    return a2 / (np.pi * d * d) * shadow * fresnel * nl


@njit(cache=True, nogil=True, inline="always")
def _window(n, view, light):  # type: ignore[no-untyped-def]
    """How much of a round soft box about `light` the mirror `n` shows, 0 to 1."""
    nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
    seen = 0.0
    for k in range(3):
        seen += (2 * nv * n[k] - view[k]) * light[k]
    return min(max((seen - 0.955) / 0.02, 0.0), 1.0)
