"""Commands of the viewer: pictures, films and pages. Need the extra `train`; pictures and films also `viewer`."""
