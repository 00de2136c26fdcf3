"""Language models that play: questions in words, replies in JSON, plans of them.

`replies` reads any reply and runs nothing of it; `prompts` says what is asked; `endpoints` asks a server; `transcripts`
keeps what was asked and answered, and `answers` takes it from there; `agent` tries a game by the protocol of
`iphyre_jax.attempts`; `runs` asks and plays as `settings` say, and goes on where it stopped; `report` writes the table.
"""
