"""What world models are worth: measures, and the document."""
