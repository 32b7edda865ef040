"""Defects of a real image: noise, lighting, blur, wear."""
