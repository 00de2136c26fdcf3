"""Show plays: pictures, films, the replay page, and the page to play on.

`recording` plays a plan and keeps every frame. `frames`, `films` and `sheets` draw recordings with Pillow (the extra
`viewer`). `page` writes them into one HTML file. `play` serves the games to a person. Importing this package alone
loads nothing.
"""
